"""The operator console in the browser: the platform's one web server.

    page (page/*.js) ──input, 50 Hz──► web_server ──► console_session ──orders──► ROS topics
         ◄──status, 20 Hz── web_server ◄── page_status ◄── system_state ◄── ROS topics
         ◄──pictures── web_server ◄── picture_queue ◄── video_node, a process of its own

``web`` is HTTP, sockets and pictures, without ROS. ``session`` is pure: it decides who drives and
whether anything may move, and holds every text for the operator. ``ros`` holds the nodes.
"""
