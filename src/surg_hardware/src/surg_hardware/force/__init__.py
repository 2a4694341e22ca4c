"""The force sensor at an arm's flange: from its readings to the forces that the guards take."""
