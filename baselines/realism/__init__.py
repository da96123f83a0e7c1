"""How far rendered pictures are from real ones, in what a network that knows pictures makes of them."""
