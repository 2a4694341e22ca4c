"""From a six-axis sensor at the flange to the forces at the tip and at the trocar.

``compensation`` takes the tool's weight off a reading, ``split`` divides the rest between the two
places where the shaft is touched, and ``estimator`` does both for a stream. ``sensor_file`` and
``force_file`` read what a cell states and what was measured; ``load_solver`` measures. The
derivation is in docs/design/force.md.
"""
