"""diffshade: the classic illumination model as a differentiable JAX program, and the tool to run it backwards.

The public names stand in `__init__.pyi`; each is imported when it is first asked for (Scientific Python's SPEC 1), so
that the command line answers `--help` before JAX is there.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
