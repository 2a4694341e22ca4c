"""Topics that public dVRK clients require and this arm does not support.

Pure module: ``interface`` (topics and answers). Node: ``dvrk_compat_node``.
"""

__version__ = "0.1.0"
