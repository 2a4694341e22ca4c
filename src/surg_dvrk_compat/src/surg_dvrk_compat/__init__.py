"""What public dVRK clients insist on and this arm does not have.

Pure module: ``interface`` (which topics, what is answered). Node: ``dvrk_compat_node``.
"""

__version__ = "0.1.0"
