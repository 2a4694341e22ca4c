"""The bundled formats: LeRobot 2.1 and 3.0, robomimic, ACT, diffusion policy."""
