"""Inverse rendering: from photographs to the parameters of a scene. The only code that knows optimistix."""
