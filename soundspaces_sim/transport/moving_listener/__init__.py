"""What a listener that moves sees of planes and edges, as far as it matters for one source that rests."""
