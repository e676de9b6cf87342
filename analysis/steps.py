"""The steps of a measurement: which are needed for the names asked for, and how they run beside each other."""

from collections.abc import Callable, Collection, Sequence
from threading import Condition
from typing import Any, NamedTuple

import numba

from morphofold.progress_callbacks import Progress
from morphofold.threads import run_parallel
from morphofold.timing import Stages, working_seconds


class Step(NamedTuple):
    """One step of a measurement.

    It runs after the steps that it ``needs``, by name; these stand before it in a list. ``makes``: the scalars, maps
    and tables that it gives. It is that ``share`` of all work, and timed and shown as ``stage``.
    """

    name: str
    needs: Sequence[str]
    makes: Sequence[str] = ()
    run: Callable[[Any], Any] | None = None
    share: float = 0.0
    stage: str = "areas"


def steps_for(names: Collection[str], steps: Sequence[Step]) -> list[Step]:
    """Those of the steps that make the names, and those that these need, in their order."""
    needed_names: set[str] = set()
    for step in reversed(steps):
        if step.name in needed_names or not set(step.makes).isdisjoint(names):
            needed_names |= {step.name, *step.needs}
    return [step for step in steps if step.name in needed_names]


def run_steps(steps: Sequence[Step], work: Any, results: dict[str, Any], progress: Progress, clock: Stages) -> None:
    """Run steps on some work beside each other, the longest first; ``results`` are by name, in their order.

    ``progress`` is called as each begins. The seconds of ``clock`` add up to the time that passed: that of steps beside
    each other is divided among them. The threads are shared by the steps that can run.
    """
    waiting_steps, running, done_share = list(steps), list[Step](), 0.0
    total_share, threads = sum(step.share for step in steps) or 1.0, numba.get_num_threads()
    condition, last_time = Condition(), working_seconds()
    # of a step and those that wait for it
    share_from = {step.name: sum(s.share for s in steps if s is step or step.name in s.needs) for step in steps}
    for step in steps:  # in their order, whichever ends first
        results[step.name] = None
        clock.add(step.stage, 0.0)

    def add_time() -> None:
        nonlocal last_time
        now = working_seconds()
        for step in running:
            clock.add(step.stage, max(now - last_time, 0.0) / len(running))
        last_time = now

    def ready() -> list[Step]:
        unfinished = {step.name for step in (*waiting_steps, *running)}
        ready_steps = [step for step in waiting_steps if unfinished.isdisjoint(step.needs)]
        return sorted(ready_steps, key=lambda step: -share_from[step.name])  # in their order where equal

    def follow() -> None:
        nonlocal done_share
        while True:
            with condition:
                condition.wait_for(lambda: not waiting_steps or ready())
                if not waiting_steps:
                    return
                add_time()
                numba.set_num_threads(max(1, threads // (len(running) + len(ready()))))
                running.append(step := ready()[0])
                waiting_steps.remove(step)
                progress(min(done_share / total_share, 1.0), step.stage)
            try:
                results[step.name] = step.run and step.run(work)
            except BaseException:
                with condition:
                    waiting_steps.clear()
                    condition.notify_all()
                raise
            with condition:
                add_time()
                running.remove(step)
                done_share += step.share
                condition.notify_all()

    run_parallel(*[follow] * len(steps))
