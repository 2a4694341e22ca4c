"""Faster ways through rospy for topics at 500 Hz, each with a switch (`switches`).

docs/design/transport.md states what each one does and what it saves.
"""
