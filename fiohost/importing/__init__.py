"""Tables from elsewhere become logs: read in whatever form they come, understood or told by a map, converted, said."""
