# studiorecon: from the videos of a few static, far-apart cameras to a 4D scene you can fly through.
# This file is the table of contents; the rules are in workflow/rules, one file per stage, in the order data flows.

from snakemake.utils import min_version

min_version("9.12")


include: "workflow/rules/common.smk"


# A stage is a word in workflow/studiorecon/stages.py, a rule file and a folder of that name.
for name in ("studio", *STAGES, "placement", "sweep", "weights", "images"):

    include: f"workflow/rules/{name}.smk"


report: "workflow/report/workflow.rst"


wildcard_constraints:
    scene="[^/]+",
    camera=camera_pattern(PLAN.cameras),
    person=r"p\d+",
    segment=r"\d+",
    picture=r"\d+",
    shot="[A-Za-z0-9_-]+",
    stranger="stranger_[A-Za-z0-9_-]+",
    donor=r"p\d+|stranger_[A-Za-z0-9_-]+",


onstart:
    # What only plans opens no film.
    refuse_unreadable()
    refuse_missing_weights()
    refuse_unwritable(written_files())


onsuccess:
    # What a user brought and the run did not use is among the last lines, in the place of the bar.
    for note in PLAN.dataset.notes:
        print_error(note)


# What comes out, in the order it is made. Every stage's product is named, not only the last file: a stage whose re-run failed
# would otherwise stay missing behind a finished-looking film.
rule all:
    default_target: True
    input:
        # Every camera's pictures on one clock, without its lens's distortion, and the room without people.
        collect("results/{scene}/capture/manifest.json", scene=PLAN.scene),
        collect("results/{scene}/capture/{camera}.mkv", scene=PLAN.scene, camera=files.cameras),
        collect("results/{scene}/plates/{camera}.png", scene=PLAN.scene, camera=files.training),
        # The cameras, as COLMAP models.
        collect("results/{scene}/cameras/{file}", scene=PLAN.scene, file=["images.txt", "refinement.json"]),
        collect("results/{scene}/cameras/heldout/images.txt", scene=PLAN.scene),
        # Who is where: keypoints, the table of people, a page to correct them on, a body for each, drawn over the pictures.
        files.detections,
        collect(
            "results/{scene}/people/{file}",
            scene=PLAN.scene,
            file=["people.tsv", "review.html"] if PLAN.people else [],
        ),
        collect("results/{scene}/people/{person}.npz", scene=PLAN.scene, person=files.people),
        collect("results/{scene}/people/overlay/{camera}.mp4", scene=PLAN.scene, camera=files.filmed_people),
        # A first film of the room; its depth, what the survey decided, and what it measured.
        collect("results/{scene}/depth/preview.mp4", scene=PLAN.scene),
        collect("results/{scene}/depth/{camera}.exr", scene=PLAN.scene, camera=files.training),
        collect(
            "results/{scene}/survey/{file}.json",
            scene=PLAN.scene,
            file=["decisions", "gains", "brightness", "specularity"],
        ),
        # Loose things, masks of people, and new views between the cameras, where the survey calls for them.
        files.loose_objects,
        collect("results/{scene}/masks/{camera}.mkv", scene=PLAN.scene, camera=files.filmed_people),
        collect("results/{scene}/views/path.json", scene=PLAN.scene),
        collect("results/{scene}/views/{segment}.mkv", scene=PLAN.scene, segment=files.segments),
        # The room and every person as Gaussians.
        collect("results/{scene}/background/scene.ply", scene=PLAN.scene),
        collect("results/{scene}/humans/{person}.{kind}", scene=PLAN.scene, person=files.people, kind=["ply", "npz"]),
        # Films: rendered (on request taken apart into EXR layers), and enhanced.
        collect("results/{scene}/render/{shot}.mkv", scene=PLAN.scene, shot=files.renders),
        collect(
            "results/{scene}/render/{shot}.layers",
            scene=PLAN.scene,
            shot=files.films if config["render"]["exr"] else [],
        ),
        collect("results/{scene}/enhance/{shot}.mp4", scene=PLAN.scene, shot=files.films),
        # How good it is, and everything on one page; the result in formats that other tools read.
        collect("results/{scene}/report/{file}", scene=PLAN.scene, file=["audit.json", "metrics.json", "index.html"]),
        collect("results/{scene}/deliver/{file}", scene=PLAN.scene, file=["manifest.json", "player.html", "scene.glb"]),
        # Nobody was warned of anything, where that is asked for.
        collect("results/{scene}/report/strict.txt", scene=PLAN.scene if config["strict"] else []),
    localrule: True


# A first look, with --configfile config/presets/look.yaml: one film, and nothing that is only measured or handed on.
rule look:
    input:
        collect("results/{scene}/enhance/{shot}.mp4", scene=PLAN.scene, shot=PLAN.first_film),
    localrule: True
