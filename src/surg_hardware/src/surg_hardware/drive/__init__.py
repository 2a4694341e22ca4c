"""The instrument's drive: servos with Dynamixel protocol 2.0 that turn wrist and jaws."""
