"""Links to Franka arms: FR3 by pylibfranka, Panda by panda-python."""
