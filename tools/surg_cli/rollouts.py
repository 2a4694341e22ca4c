"""Roll-outs of a policy in the graph, one after another; what is done is not done again."""

from __future__ import annotations
