"""``fiohost lab NAME``: one module for each experiment's options."""
