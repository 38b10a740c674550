"""Exchange: materials and lamps to and from the files of other programs."""
