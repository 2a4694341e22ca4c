"""Episode folders: reading, writing, finishing and recovering them.

``from surg_recording import episode; episode.read(folder)`` reads one.
"""

from surg_recording.episode.episode_reader import Episode, read
from surg_recording.episode.table import Table, Video

__all__ = ["Episode", "Table", "Video", "read"]
