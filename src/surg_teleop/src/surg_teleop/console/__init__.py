"""The operator console in the browser: the platform's one web server.

    page (page/*.js) ──input, 50 Hz──► server ──► session ──orders──► console_node ──► topics
         ◄──status, 20 Hz── server ◄── report ◄── robot (what the topics said)
         ◄──pictures── server ◄── lane ◄── video_node, a process of its own

Pure: `protocol` (what a page may say), `session` (who drives, and whether anything may move),
`report` and `words` (what is said to people), `access` (who may connect), `lane` and `wire` (how
pictures travel), `codec` (how they are made), `episodes` (what has been recorded). `server` is
aiohttp and knows no ROS; `console_node` and `video_node` are the nodes.
"""
