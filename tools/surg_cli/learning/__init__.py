"""Roll-outs of `./surg learn`: a learned policy in the graph."""
