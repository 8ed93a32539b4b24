"""References by Blender's Cycles: the same scene, by a renderer that owes nothing to ours.

Importing this package needs no bpy: Blender runs in processes of its own, which only render.py,
build_scene.py and cycles_settings.py are part of.
"""

from penumbra.blender_ref.parts import OptionsError, reference
from penumbra.blender_ref.process import Cycles, CyclesError, MissingBlender
from penumbra.blender_ref.renderer import CyclesRenderer

__all__ = [
    "Cycles",
    "CyclesError",
    "CyclesRenderer",
    "MissingBlender",
    "OptionsError",
    "reference",
]
