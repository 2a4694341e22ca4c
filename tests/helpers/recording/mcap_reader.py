"""Reads an MCAP file with PyPI's mcap and mcap-ros1-support; prints what it holds as JSON."""

from __future__ import annotations

import json
import sys

import mcap
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros1.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    header = reader.get_header()
    counts: dict[str, int] = {}
    setpoints = []
    for _, channel, message, decoded in reader.iter_decoded_messages():
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
        if channel.topic == "/PSM1/setpoint_cp":
            p = decoded.pose.position
            setpoints.append([message.log_time, p.x, p.y, p.z])
    metadata = {each.name: each.metadata for each in reader.iter_metadata()}
with open(sys.argv[1], "rb") as file:
    straight = sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages())
statistics = summary.statistics
print(
    json.dumps(
        {
            "mcap": mcap.__version__,
            "profile": header.profile,
            "messages": statistics.message_count,
            "chunks": statistics.chunk_count,
            "indexed": len(summary.chunk_indexes),
            "counts": counts,
            "straight": straight,
            "metadata": metadata,
            "setpoints": setpoints,
        }
    )
)
