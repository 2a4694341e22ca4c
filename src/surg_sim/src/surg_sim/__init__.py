"""The simulated operating room: MuJoCo arms behind the link contract, tasks, environments."""

__version__ = "0.1.0"
