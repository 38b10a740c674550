"""Lamp files: IES and EULUMDAT."""
