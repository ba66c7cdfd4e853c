"""How well a model does: its figures on records, how small they could be, and what that says of it."""
