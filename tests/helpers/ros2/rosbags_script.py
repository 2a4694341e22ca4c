"""The CDR that `rosbags` makes of ROS 1 bytes; runs in an environment of its own.

Standard input: `{type: [definition, [bytes in hexadecimal, …]]}` in JSON; output: the same, in CDR.
"""

from __future__ import annotations

import json
import sys

from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def main() -> None:
    """Convert what stands on standard input."""
    store = get_typestore(Stores.ROS2_JAZZY)
    found = {}
    for kind, (definition, messages) in json.load(sys.stdin).items():
        name = kind.replace("/", "/msg/")
        types = get_types_from_msg(definition, name)
        store.register({each: of for each, of in types.items() if each not in store.fielddefs})
        found[kind] = [bytes(store.ros1_to_cdr(bytes.fromhex(m), name)).hex() for m in messages]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
