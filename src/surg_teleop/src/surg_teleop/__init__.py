"""From a hand to an arm: leaders, the states between both, camera frames, and recorded motions."""
