"""What a guided session says of the hand: how near, how straight, how fast, how smooth."""
