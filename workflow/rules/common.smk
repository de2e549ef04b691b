# What rules ask: PLAN is what was decided (workflow/studiorecon/plan), files are the paths that hang on it.
# Here stands only what needs Snakemake's own names: config, workflow, local, checkpoints.

import json
import logging
import os
import shlex
import time
from pathlib import Path

import yaml
from snakemake.logging import logger

from studiorecon import code as package_code
from studiorecon.errors import UserError
from studiorecon.machine.crash_report import fault_sentence, keep_trace
from studiorecon.machine.resource_errors import describe_resource_error
from studiorecon.plan.stale_lock import clear_stale_lock
from studiorecon.models.catalogue.selection import adapter_modules
from studiorecon.plan import step_config
from studiorecon.plan.command import command
from studiorecon.plan.dataset import resolve_path
from studiorecon.plan.dates import refuse_future
from studiorecon.plan.memory import drawn_mb, fit_mb, memory, room_mb
from studiorecon.plan.decisions import camera_pattern
from studiorecon.plan.rule_files import Files
from studiorecon.plan.make import make_plan
from studiorecon.plan.films import unreadable_footage
from studiorecon.plan.networks import missing_files, read_images
from studiorecon.configuration.overlays import check_overlay
from studiorecon.configuration.schema import mistakes, coerce_types
from studiorecon.progress import print_error
from studiorecon.stages import STAGES
from studiorecon.sweep.table import BASE, read_rows

# On a full disk every line of Snakemake's own log would print a trace; the step that fails says what is full.
logging.raiseExceptions = False

HOME = Path(workflow.basedir)
# Where results lie beside the workflow its files are named from there: a folder that is moved whole stays as finished as it was.
if HOME.is_relative_to(Path.cwd()):
    HOME = HOME.relative_to(Path.cwd())


# libyaml reads it in a tenth of the time that plain Python takes; every start of Snakemake waits for it.
SCHEMA = yaml.load(
    (HOME / "workflow/schemas/config.schema.yaml").read_text(encoding="utf-8"),
    getattr(yaml, "CSafeLoader", yaml.SafeLoader),
)


def refuse(sentence):
    """End with a sentence alone: Snakemake would add where in its files it was said."""
    logger.error(sentence)
    raise SystemExit(1)


def refuse_error(error):
    """The same for an error: what a user has to know of it."""
    is_ours = isinstance(error, UserError)
    refuse(str(error) if is_ours else describe_resource_error(error) or fault_sentence(error, keep_trace(error)))


def check_setting_files():
    """Refuse a file of settings that cannot be read: Snakemake would not name it."""
    try:
        for file in (HOME / "config/config.yaml", *(workflow.config_settings.configfiles or ())):
            check_overlay(Path(file))
    except UserError as refusal:
        refuse(str(refusal))


def check_settings():
    """Read every setting as what the schema says it is; refuse a configuration that breaks it, in a sentence per mistake."""
    config.update(coerce_types(config, SCHEMA))
    if wrong := mistakes(config, SCHEMA):
        refuse("\n".join([*wrong, "config/README.md explains every setting"]))


def decided():
    """The plan of this configuration; what cannot be run is refused in a sentence."""
    try:
        plan = make_plan(config, HOME)
        refuse_future(plan.dataset.folder, Path("results") / plan.scene, time.time())
        return plan
    except Exception as error:
        refuse_error(error)


def bought_by_budget():
    """What budget_min buys, laid into the configuration and said; empty without a budget."""
    if not config["budget_min"]:
        return {}
    # Opens videos, which a plan does without otherwise.
    from studiorecon.plan.budget import choose_preset

    try:
        # workflow.cores is what --cores allows; --lint and --unlock are given no number.
        said = workflow.config_settings.overwrite_config  # of --config and --configfile
        choice = choose_preset(config, said, SCHEMA, decided(), workflow.cores or os.cpu_count() or 1)
    except Exception as error:
        refuse_error(error)
    config.update(choice.chosen.config)
    logger.info(choice.sentence())
    return choice.as_json()


def take_left_lock():
    """A killed run leaves its lock, which Snakemake would ask for --unlock to take away."""
    if workflow.is_main_process and not workflow.dryrun and (said := clear_stale_lock(Path())):
        logger.info(said)


def refuse_unreadable():
    """Refuse footage that a job is about to read and cannot, before anything is made of the other cameras'."""
    if PLAN.studio:
        return
    read = {str(file) for job in workflow.dag.needrun_jobs() for file in job.input}
    films = {camera: PLAN.dataset.chapters.get(camera, (film,)) for camera, film in PLAN.dataset.footage.items()}
    if sentences := unreadable_footage(
        {c: [film for film in parts if str(film) in read] for c, parts in films.items()}
    ):
        refuse("\n".join(sentences))


def refuse_missing_weights():
    """Refuse a run whose networks lack a file, before hours of other steps."""
    steps = {job.rule.name.replace("_", ".", 1) for job in workflow.dag.needrun_jobs()}
    if sentences := missing_files(PLAN.networks, config, steps):
        refuse("\n".join(sentences))


def refuse_unwritable(files):
    """Refuse a folder that a run writes into and may not: Snakemake would fail there without a sentence."""
    folders = {next(folder for folder in Path(file).absolute().parents if os.path.lexists(folder)) for file in files}
    if closed := [str(folder) for folder in sorted(folders) if not os.access(folder, os.W_OK | os.X_OK)]:
        names = ", ".join(closed)
        refuse(f"{names} is no folder that may be written into; move it away, or: chmod -R u+rwX {shlex.join(closed)}")


def written_files():
    """Every file that a job of this run writes."""
    for job in workflow.dag.needrun_jobs():
        yield from (*job.output, *job.log, *([job.benchmark] if job.benchmark else []))


if workflow.is_main_process and not workflow.dryrun:
    refuse_unwritable([".snakemake/locks/lock"])
take_left_lock()
check_setting_files()


configfile: HOME / "config/config.yaml"


check_settings()
BUDGET = bought_by_budget()
PLAN = decided()
# The logger says where results are; a run with nothing to do names no scene to it.
os.environ.update(STUDIORECON_SCENE=str(PLAN.scene))
IMAGES = read_images(config, HOME)
files = Files(PLAN, config, HOME, local, checkpoints)
# The container image of that name, that of an upstream network, and the GPUs that a job of it holds.
image, model_image, gpus = IMAGES.named, IMAGES.of_network, IMAGES.gpus

# The cameras of results: a step gets the first file, and reads the other in its folder.
MODEL = [f"results/{{scene}}/cameras/{name}.txt" for name in ("images", "cameras")]
HELDOUT_MODEL = [f"results/{{scene}}/cameras/heldout/{name}.txt" for name in ("images", "cameras")]

# The scene as Gaussians: what is drawn or delivered.
TRAINED = {
    "background": "results/{scene}/background/scene.ply",
    "provenance": "results/{scene}/background/provenance.npz",
    "gaussians": files.human_gaussians,
    "avatars": files.human_avatars,
    "body": files.body,
    "objects": files.loose_objects,
}


def settings(step):
    """The settings that one step reads, as JSON."""
    return step_config.step_settings(step, config)


def shot_settings(step, *keys):
    """The same for a step of one shot, with of render.shots this shot alone."""
    return step_config.shot_settings(step, config, keys)


def code(step):
    """Digest of the code a step imports from this package, so that an edited line re-runs it, and of the networks' adapters that it runs."""
    return package_code.digest(step, adapter_modules(step, config))


def no_container(wildcards):
    """For a rule that must run outside of images whatever --sdm says; the linter wants every rule to say something."""
    return None


def threads_beside(jobs, most=2):
    """Threads of a job that runs beside others, so many in all: a second thread makes it faster by a third, a second job twice as much
    is done."""
    cores = workflow.resource_settings.cores
    # On a cluster each has a machine of its own.
    return most if cores is None or workflow.remote_exec else max(1, min(most, cores // jobs))


def every_core(wildcards):
    """All that --cores allows. Asked only when the job is planned: --unlock and --lint are given no number."""
    return workflow.cores


def sweep_records(wildcards):
    """The record of every row of the sweep's table, in its order."""
    try:
        rows = read_rows(Path(resolve_path(config["sweep"], HOME)))
    except UserError as refusal:
        refuse(str(refusal))
    return [f"results/{wildcards.scene}/sweep/{wildcards.table}/{row.name}.json" for row in rows]


def base_record(wildcards):
    """The record of the base, whose run every other row starts from."""
    return [] if wildcards.row == BASE else [f"results/{wildcards.scene}/sweep/{wildcards.table}/{BASE}.json"]
