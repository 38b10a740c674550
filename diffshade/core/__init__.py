"""Core: precision and compiler, checked fields, progress, and the words of messages; knows nothing of light."""
