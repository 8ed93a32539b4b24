"""The process that has Mitsuba in it: one request, one answer, each a line of JSON.

Started by systems.py with the interpreter that has Mitsuba, which need not be ours: nothing but
Mitsuba and the standard library is imported here. The first request is {variant, threads, scene},
each later one {samples, seed, out}. It ends when its standard input does.
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import Any


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    try:
        render, first = _open(json.loads(sys.stdin.readline()))
        print(json.dumps(first), file=answers)
        for line in sys.stdin:
            print(json.dumps(render(json.loads(line))), file=answers)
    except Exception as error:  # the other side is to say it, whatever it is
        print(json.dumps({"failed": str(error) or repr(error)}), file=answers)


def _open(request: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(request["variant"])
    dr.set_thread_count(request["threads"])
    scene = mi.load_dict(_with_transforms(request["scene"], mi))

    def render(asked: dict[str, Any]) -> dict[str, Any]:
        start = time.perf_counter()
        image = mi.render(scene, spp=asked["samples"], seed=asked["seed"])
        dr.eval(image)
        dr.sync_thread()
        seconds = time.perf_counter() - start
        mi.Bitmap(image).write(asked["out"])
        return {"seconds": seconds}

    return render, {"version": mi.__version__}


def _with_transforms(value: Any, mi: Any) -> Any:
    """The scene with each "to_world", four rows of numbers, made Mitsuba's."""
    if not isinstance(value, dict):
        return value
    return {
        key: mi.ScalarTransform4f(inner) if key == "to_world" else _with_transforms(inner, mi)
        for key, inner in value.items()
    }


if __name__ == "__main__":
    main()
