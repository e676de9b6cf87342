"""Memory of a run: what its arrays take, and the process around them."""

from __future__ import annotations

from morphofold.forecasts.sizes import Sizes
from morphofold.forecasts.table import costs

GiB = 2**30


def building_bytes(elements: int, *, bricks: bool, single: bool = True) -> float:
    """Most bytes that are held at once while a body is built."""
    memory = costs()["memory"]
    if not bricks:
        return memory["building_tet"] * elements
    passing = (memory["building_brick"] - memory["built_brick"]) * elements
    built = memory["built_brick"] + (0 if single else memory["double"])
    return built * elements + min(passing, memory["most_building"])


def running_bytes(elements: int, *, bricks: bool, single: bool = True) -> float:
    """Bytes that body and dynamics hold while steps are taken."""
    memory = costs()["memory"]
    if not bricks:
        return memory["per_tet"] * elements
    return (memory["per_brick"] + (0 if single else memory["double"])) * elements


def memory_GiB(sizes: Sizes, *, bricks: bool, single: bool, volume: bool) -> float:
    """Most memory of a whole process that runs a scene, started for it alone [GiB]."""
    memory = costs()["memory"]
    stage = memory["stage_per_vertex"] * sizes.vertices
    stage += memory["stage_per_element"] * sizes.elements if volume else 0.0
    building = memory["importing"] + building_bytes(sizes.elements, bricks=bricks, single=single) / GiB
    running = memory["process"] + (running_bytes(sizes.elements, bricks=bricks, single=single) + stage) / GiB
    return max(building, running)
