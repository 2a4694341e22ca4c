"""The simulated operating room: MuJoCo arms, trocars and an endoscope behind the link contract.

Pure modules (no ROS): ``scene``, ``arm``, ``jaw``, ``trocar``, ``trocar_motion``, ``truth``,
``world``, ``faults``, ``injector``, ``lockstep``, ``wire``, ``settings``, ``render``, ``picture``,
``anatomy``, ``textures``, ``endoscope``, ``patient``, ``room``, ``drawing``, ``placement``,
``speed``. Nodes: ``bridge_node`` (``/sim``) and ``endoscope_node`` (``/endoscope``).
"""

__version__ = "0.1.0"
