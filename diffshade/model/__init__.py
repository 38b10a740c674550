"""Model: the illumination model forward, from vectors to rendered images; reads no file."""
