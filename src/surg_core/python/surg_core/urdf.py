"""The part of URDF that the core needs: the joints between two links, as a chain or one pose.

The reader is C++ (``src/files/urdf.cpp``), the same for nodes, checks and simulator.
"""

from surg_core._core import Urdf as Urdf
from surg_core._core import UrdfJoint as UrdfJoint
from surg_core._core import UrdfLimit as UrdfLimit
from surg_core._core import UrdfMimic as UrdfMimic
from surg_core._core import chain_from_urdf as chain_from_urdf
from surg_core._core import fixed_transform as fixed_transform
from surg_core._core import load_chain as load_chain
from surg_core._core import load_urdf as load_urdf
from surg_core._core import read_joints as read_joints
