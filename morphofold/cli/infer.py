"""``morphofold infer``: the growth map with which a body folds like a person, beside its controls.

In go the options, out comes what is printed; the work is in :mod:`morphofold.inference`.
"""

import secrets
from contextlib import ExitStack

from morphofold.cli.command_options import Answer, Infer
from morphofold.cli.many_tasks import answer_of, open_workers, print_note, run_with_progress
from morphofold.cli.terminal_output import progress
from morphofold.group.sweep import grow_and_measure
from morphofold.group_pages.inference_page import inference_report
from morphofold.inference.inference import person_of, result_of, write_result
from morphofold.inference.inference_runs import make_plan, tasks_of
from morphofold.io import begin_collection, refuse_foreign, refuse_no_collection
from morphofold.io.atomic_folders import alone


def run(args: Infer) -> Answer:
    out = args.out.absolute()
    refuse_no_collection(out, "inference")
    refuse_foreign(out / "result")
    with progress("infer ", args.quiet) as on_progress:
        plan = make_plan(
            args.subject,
            args.hemi,
            args.heterogeneity,
            seeds=args.seeds,
            turns=args.rotations,
            thin_crowns=args.thin_crowns,
            progress=on_progress,
        )
    with ExitStack() as locks:
        with open_workers(args) as workers:
            begin_collection(out, "inference")
            locks.enter_context(alone(out))
            tasks, applied = tasks_of(plan, out, secrets.token_hex(4), args.threads)
            cortex_text = f"a cortex of {plan.thickness:g} mm grows to g = {plan.growth:g}"
            print_note(f"{len(tasks)} bodies, {cortex_text}; {workers.label}", args)
            outcomes = run_with_progress(workers, "infer ", grow_and_measure, tasks, args)
        with progress("compare ", args.quiet) as on_progress:
            inference = result_of(plan, person_of(plan), out, applied, spins=args.spins, progress=on_progress)
            page = write_result(inference, out, report=inference_report)
    return answer_of(outcomes, "run", page, inference.lines, result=inference.to_dict())
