"""Data: views, their samples, and folders of photographs."""
