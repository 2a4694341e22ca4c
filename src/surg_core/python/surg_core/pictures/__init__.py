"""From points in space to pixels of an eye's raw picture.

``lens_model`` is the lens, ``camera_model`` reads one from a camera's own statement, and
``eye_projection`` and ``plan_projection`` say where points and planned tips are in a picture.
"""
