"""OptiTrack motion capture (Motive) over NatNet."""
