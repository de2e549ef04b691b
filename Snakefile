# studiorecon: from the videos of a few static, far-apart cameras to a 4D scene you can fly through.
# This file is the table of contents; the rules are in workflow/rules, one file per stage, in the order data flows.

from pathlib import Path

from snakemake.utils import min_version

min_version("9.12")


configfile: Path(workflow.basedir) / "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/studio.smk"
include: "workflow/rules/capture.smk"
include: "workflow/rules/cameras.smk"
include: "workflow/rules/doctor.smk"
include: "workflow/rules/planner.smk"
include: "workflow/rules/people.smk"
include: "workflow/rules/masks.smk"
include: "workflow/rules/depth.smk"
include: "workflow/rules/survey.smk"
include: "workflow/rules/views.smk"
include: "workflow/rules/background.smk"
include: "workflow/rules/humans.smk"
include: "workflow/rules/render.smk"
include: "workflow/rules/enhance.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/deliver.smk"
include: "workflow/rules/sweep.smk"
include: "workflow/rules/weights.smk"
include: "workflow/rules/images.smk"


report: "workflow/report/workflow.rst"


wildcard_constraints:
    scene="[^/]+",
    camera=ONE_OF_THE_CAMERAS,
    person=r"p\d+",
    segment=r"\d+",
    picture=r"\d+",
    shot="[A-Za-z0-9_-]+",


# Every stage's product is named, not only the last file: a stage whose re-run failed would otherwise stay missing
# behind a finished-looking film.
rule all:
    default_target: True
    input:
        scene_products(),
        decided_products,
    localrule: True
