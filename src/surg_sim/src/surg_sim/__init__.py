"""The simulated operating room: MuJoCo arms, trocars and an endoscope behind the link contract."""

__version__ = "0.1.0"
