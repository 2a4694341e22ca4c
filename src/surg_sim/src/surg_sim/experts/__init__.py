"""Scripted senders: what a person at the console or at the assistant's instrument would do.

Pure: a sender looks at one tick and says what it sends for the next one. The nodes
``expert_node`` and ``assistant_node`` put them on the topics that a person uses.
"""
