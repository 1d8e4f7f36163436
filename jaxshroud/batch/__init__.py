"""Many lanes on a machine: all that knows XLA, states and periods of many lanes, threads, tangents."""
