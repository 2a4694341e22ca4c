"""Links to real robot arms: pure cores, one folder for each vendor, and a thin ROS node.

No real arm has been driven by this package. It drives the emulated controllers of
``surg_emulators``.
"""
