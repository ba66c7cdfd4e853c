"""Many benches: each diagnosed by itself, all of them compared, and what a type has in common estimated together."""
