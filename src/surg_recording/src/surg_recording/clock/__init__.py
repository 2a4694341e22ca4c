"""Time of an episode: clock steps, synchronisation of machines, and a report on both."""
