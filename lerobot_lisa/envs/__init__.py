"""Simulated worlds as LeRobot environments, one folder for each family; importing this registers all of them.

A family's folder holds `config.py`, its options, which register themselves and are light to import, and `env.py`, the
gymnasium environment, which imports the simulator. Nothing else has to be told of a new folder.
"""

from importlib import import_module
from pkgutil import iter_modules

for _family in iter_modules(__path__):
    if _family.ispkg:
        import_module(f"{__name__}.{_family.name}")
