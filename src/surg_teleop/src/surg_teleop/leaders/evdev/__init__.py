"""Input devices of the kernel (evdev): gamepads, pedals and SpaceMice as leaders.

bytes -> ``input_events`` -> ``device_state`` (axes -1 ... 1, keys) -> ``device_hand`` (Joy, rates,
buttons, as a ``device_layout`` file names them). ``device_search`` chooses the device,
``device_leader`` reads it, and only ``device_host`` touches ``/dev/input``.
"""
