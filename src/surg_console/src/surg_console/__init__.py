"""The operator console in the browser: the platform's one web server.

    page (page/*.js) ──input, 50 Hz──► control_socket ──► console_session ──orders──► ROS topics
         ◄──status, 20 Hz── control_socket ◄── page_status ◄── system_state ◄── ROS topics
         ◄──pictures── picture_socket ◄── picture_queue ◄── video_node, a process of its own

``web`` is HTTP, sockets and pictures, without ROS; `page_server` is what all pages share.
``labelling`` serves the label page by itself. ``session`` is pure: it decides who drives and
whether anything may move, and holds every text for the operator. ``ros`` holds the nodes.
"""
