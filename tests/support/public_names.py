"""The public names, those of the rooms included."""

import inspect

import diffshade as ds

ROOMS = {name: of for name in dir(ds) if inspect.ismodule(of := getattr(ds, name))}
TOP = {name: getattr(ds, name) for name in dir(ds) if name not in ROOMS}
PUBLIC = TOP | {
    name: of
    for room, module in ROOMS.items()
    if room != "extension"
    for name in dir(module)
    if not name.startswith("_") and not inspect.ismodule(of := getattr(module, name))
}
