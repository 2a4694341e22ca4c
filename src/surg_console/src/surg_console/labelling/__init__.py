"""Labels episodes after the recording: the page of an episode with keys for verdict and stages."""
