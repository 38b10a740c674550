"""The page of maps: an object that is lit by hand, from its maps, photographs and heights."""
