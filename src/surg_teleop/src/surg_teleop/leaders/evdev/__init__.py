"""Input devices of the kernel (evdev): bytes in, the state of a gamepad, pedal or SpaceMouse out.

bytes -> :mod:`events` -> :mod:`state` (axes -1 ... 1, keys) -> :mod:`hand` (Joy, rates, buttons, as
a :mod:`layout` file names them). :mod:`find` chooses the device, :mod:`leader` reads it and notices
that it has gone; :mod:`host` is all that touches ``/dev/input``.
"""
