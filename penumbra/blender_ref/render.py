"""The process that has Blender in it: one request, one answer, each a line of JSON.

Started by process.py, not by people. The first request names the scene, each later one asks for
an image or for the .blend. It ends when its standard input does, even in the middle of a render,
and takes its temporary folder with it: nothing is left behind if we are killed.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

Message = dict[str, Any]


def main(folder: str) -> None:
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what Blender prints goes where stderr goes, to the log
    requests: queue.Queue[Message] = queue.Queue()
    threading.Thread(target=_read, args=(requests, folder), daemon=True).start()
    answer: Callable[[Message], Message] = _open
    while True:
        request = requests.get()
        try:
            message = answer(request)
        except ImportError as error:
            message = {"missing": f"bpy cannot be imported: {error}"}
        except Exception as error:  # the other side is to say it, whatever it is
            unsupported = type(error).__name__ == "UnsupportedScene"
            message = {"unsupported" if unsupported else "failed": str(error) or repr(error)}
        print(json.dumps(message), file=answers)
        answer = _blend_or_image


def _read(requests: queue.Queue[Message], folder: str) -> None:
    for line in sys.stdin:
        requests.put(json.loads(line))
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


def _open(request: Message) -> Message:
    """Build the scene. {scene_file, scene_hash, width, height, antialias} -> settings and so on"""
    import bpy  # here, so that the other side hears of a failure

    from penumbra.blender_ref import build_scene, cycles_settings
    from penumbra.compare.scene import read_scene

    scene = read_scene(request["scene_file"])
    if scene.hash != request["scene_hash"]:
        raise RuntimeError(f"{request['scene_file']} changed while it was read")
    width, height = request["width"], request["height"]
    blender_scene = build_scene.build_scene(scene, width / height)
    film = cycles_settings.film_settings(
        width, height, request["antialias"], build_scene.transparent_surfaces(scene)
    )
    held = cycles_settings.apply_settings(blender_scene, cycles_settings.SETTINGS + film)
    return {
        "settings": held,
        "sampler": cycles_settings.SAMPLER,
        "threads": blender_scene.render.threads,
        "blender": bpy.app.version_string,
    }


def _blend_or_image(request: Message) -> Message:
    return _save_blend(request) if "blend" in request else _render(request)


def _render(request: Message) -> Message:
    """Write the raw EXR. {samples, seed, out} -> {seconds}"""
    import bpy

    from penumbra.blender_ref import cycles_settings

    scene = bpy.context.scene
    settings = cycles_settings.sample_settings(request["samples"], request["seed"])
    cycles_settings.apply_settings(scene, settings)
    scene.render.filepath = request["out"]
    start = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    seconds = time.perf_counter() - start
    if not Path(request["out"]).is_file():
        raise RuntimeError("Cycles wrote no image")
    return {"seconds": seconds}


def _save_blend(request: Message) -> Message:
    """{blend, samples, seed} -> {}; F12 in the saved file renders with these."""
    import bpy

    from penumbra.blender_ref import cycles_settings

    scene = bpy.context.scene
    settings = cycles_settings.sample_settings(request["samples"], request["seed"])
    cycles_settings.apply_settings(scene, settings)
    scene.render.filepath = "//render.exr"
    bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside it
    bpy.ops.wm.save_as_mainfile(filepath=request["blend"], copy=True, compress=True)
    return {}


if __name__ == "__main__":
    main(sys.argv[1])
