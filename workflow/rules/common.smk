# The only functions of the workflow. Rules are data: what they need to know about the dataset, the people that were found
# and the settings, they ask here.

import dataclasses
import json
import re
from pathlib import Path

import yaml
from snakemake.exceptions import WorkflowError

from studiorecon import code as package_code
from studiorecon.errors import Refusal
from studiorecon.models.registry import MODELS
from studiorecon.models.selection import check_licences, selected
from studiorecon.scene.dataset import colmap_files, open_dataset
from studiorecon.scene.people import read_people
from studiorecon.schema import mistakes, typed
from studiorecon.step_settings import told
from studiorecon.studio.description import planned_dataset, read_description

IMAGES = yaml.safe_load((Path(workflow.basedir) / "envs/images.yaml").read_text())


def check_settings():
    """Read every setting as what the schema says it is; refuse a configuration that breaks it, in a sentence per mistake."""
    schema = yaml.safe_load((Path(workflow.basedir) / "workflow/schemas/config.schema.yaml").read_text())
    config.update(typed(config, schema))
    if wrong := mistakes(config, schema):
        raise WorkflowError("\n".join([*wrong, "config/README.md explains every setting"]))


check_settings()


def beside_workflow(path):
    """A path of the configuration: as given when it exists from here, else beside the Snakefile; never in a bucket."""
    return local(str(path) if Path(path).is_file() else str(Path(workflow.basedir) / path))


def find_dataset():
    """The dataset, its made-studio name ("" for a user's own) and description; a sentence when there is none."""
    given = Path(config["dataset"])
    try:
        if given.suffix in (".yaml", ".yml"):
            description = Path(beside_workflow(given))
            folder = Path("results/studio") / description.stem
            planned = planned_dataset(read_description(description), folder / "dataset", folder / "truth")
            return planned, description.stem, local(str(description))
        capture_yaml = Path(config["capture_yaml"]) if config["capture_yaml"] else None
        return open_dataset(given, capture_yaml), "", ""
    except Refusal as refusal:
        raise WorkflowError(str(refusal)) from None


DATASET, STUDIO, DESCRIPTION = find_dataset()
# Decisions made beforehand: effect → on or off.
FORCED = config["survey"]["force"]
if FORCED.get("people") == "off":
    DATASET = dataclasses.replace(DATASET, people=False)
GIVEN_BODY = beside_workflow(config["body"])
# SMPL's own pickle becomes plain arrays first.
BODY = f"results/body/{Path(GIVEN_BODY).stem}.npz" if GIVEN_BODY.endswith(".pkl") else GIVEN_BODY
SCENE = str(config["scene"]) or STUDIO or DATASET.folder.resolve().name
CAMERAS = list(DATASET.cameras)
ONE_OF_THE_CAMERAS = "|".join(map(re.escape, CAMERAS))
TRAINING = list(DATASET.training)
HELDOUT = list(DATASET.held_out)
# Cameras with a clean plate of the user's own: there, people without keypoints stand out (people.hull).
PLATED = [c for c in TRAINING if c in DATASET.plates] if config["people"]["hull"]["use"] == "auto" else []
# The user's own say on who is who: a file named in the configuration counts before the dataset's.
CORRECTED = (
    [local(str(config["people"]["identities"]))]
    if config["people"]["identities"]
    else [str(DATASET.identities) if STUDIO else local(str(DATASET.identities))] if DATASET.identities else []
)
SEGMENTS = [f"{i:02d}" for i in range(len(TRAINING) if config["views"]["closed"] else len(TRAINING) - 1)]
# Every film, and "train": the training cameras themselves, which enhancement and report compare with the photos.
FILMS = [shot for shot in config["render"]["shots"] if shot != "heldout" or HELDOUT]
SHOTS = ["train", *FILMS]
# Records of the sweeps that were run on this scene.
SWEEPS = sorted(map(str, Path(f"results/{SCENE}/sweep").glob("*/records.jsonl")))

# Who is where comes from keypoint files, from the detector, or from a network that estimates bodies (people.source).
BODY_SOURCE = "" if config["people"]["source"] in ("auto", "keypoints", "detector") else config["people"]["source"]
# Cameras in whose pictures the detector looks for people: those without keypoint files, or all.
DETECTED = (
    {
        "auto": [c for c in CAMERAS if c not in DATASET.keypoints],
        "detector": CAMERAS,
    }.get(config["people"]["source"], [])
    if DATASET.people
    else []
)
# Cameras in which people can be told before there is a calibration.
WATCHED = [c for c in CAMERAS if c in DATASET.keypoints or c in DETECTED]
# Those that the doctor looks at: nobody is looked for in held-out pictures for its sake.
CHECKED = [c for c in WATCHED if c in TRAINING or c not in DETECTED]
SIGHTED = bool(WATCHED) or bool(BODY_SOURCE)
LANDMARKS = {"blazepose": "pose_landmark_full.onnx", "blazepose_heavy": "pose_landmark_heavy.onnx"}[config["people"]["detector"]]
DETECTOR_FILES = [
    local(str(Path(workflow.basedir) / "resources/detector" / name)) for name in ("pose_detection.onnx", LANDMARKS, "confidence.json")
]

# The cameras of results: a step is told the first file, and reads the other beside it.
MODEL = [f"results/{{scene}}/cameras/{name}.txt" for name in ("images", "cameras")]
HELDOUT_MODEL = [f"results/{{scene}}/cameras/heldout/{name}.txt" for name in ("images", "cameras")]

# Cameras whose people tell, before there is a calibration, when each was started.
# Where only a part of the footage is used, the detector looks at that part alone, which the clocks must say first.
PART_USED = bool(DATASET.first_frame or DATASET.frame_count)
TIMED = [c for c in CHECKED if c not in DETECTED or not PART_USED] if DATASET.people and config["capture"]["sync"] != "never" else []

# Cameras come from the user's files or from the people in the pictures.
FROM_PEOPLE = config["cameras"]["source"] == "people" or (
    config["cameras"]["source"] == "auto" and not DATASET.calibration and bool(WATCHED)
)

# Or from a network, whose COLMAP model is then read like the user's.
CAMERA_NETWORK = config["cameras"]["source"] if config["cameras"]["source"] in MODELS else ""
CALIBRATION = (
    [f"results/{SCENE}/cameras/network/{name}.txt" for name in ("cameras", "images")]
    if CAMERA_NETWORK
    else [str(file) if STUDIO else local(str(file)) for file in DATASET.calibration]
)

if CAMERA_NETWORK and DATASET.pixel_maps:
    raise WorkflowError(
        f"cameras.source is {CAMERA_NETWORK}, which looks at the footage itself, but capture.yaml has pixel_maps, which belong to a calibration: "
        "take them out, or set cameras.source to files"
    )
if not FROM_PEOPLE and not CAMERA_NETWORK and not DATASET.calibration:
    raise WorkflowError(
        f"dataset {DATASET.folder} has no calibration: put intri.yml and extri.yml, a COLMAP model (sparse/0), a Pose2Sim or "
        "caliscope .toml, a .qca.txt or a transforms.json there, or name it in capture.yaml (calibration: FILE)"
    )
if CORRECTED and not Path(CORRECTED[0]).is_file():
    raise WorkflowError(f"people.identities names {CORRECTED[0]}, which does not exist; copy results/{SCENE}/people/identities.tsv there")
if DATASET.people and not SIGHTED and len(PLATED) < config["people"]["hull"]["limits"]["cameras"]:
    raise WorkflowError(
        f"dataset {DATASET.folder} has no 2D keypoints and people.source is keypoints: set it to auto, put keypoints/<camera>/*.json (OpenPose, "
        f"AlphaPose, MMPose, …) there, or clean plates of {config['people']['hull']['limits']['cameras']} training cameras (plates/<camera>.png; there are {len(PLATED)}), or "
        "write people: 0 into capture.yaml for an empty room"
    )
if WATCHED and DATASET.people and not BODY_SOURCE and (blind := [c for c in TRAINING if c not in WATCHED]):
    raise WorkflowError(
        f"camera {blind[0]} of dataset {DATASET.folder} has no keypoints in {next(iter(DATASET.keypoints.values())).parent}: "
        f"add {blind[0]}/*.json there, leave the camera out with train: [...] in capture.yaml, or set people.source to auto"
    )
if FROM_PEOPLE and (unseen := [c for c in CAMERAS if c not in WATCHED]):
    raise WorkflowError(
        f"dataset {DATASET.folder} has no calibration, so its cameras are found from people, and camera {unseen[0]} has no keypoints: add "
        f"{unseen[0]}/*.json, set people.source to auto, leave the camera out with train: [...] in capture.yaml, or bring a calibration"
    )


# Upstream networks that the configuration asks for; empty where a stage's own method is used.
try:
    check_licences(config)
except Refusal as refusal:
    raise WorkflowError(str(refusal)) from None
SELECTED = sorted({model for _, model in selected(config)})
WEIGHTS = config["weights"] if Path(config["weights"]).is_dir() else str(Path(workflow.basedir) / config["weights"])
DEPTH_NETWORK = "" if config["depth"]["source"] == "embedded" else config["depth"]["source"]
MASK_NETWORK = config["masks"]["source"] if config["masks"]["source"] in MODELS else ""
SYNTHESIZER = config["views"]["synthesizer"]
# Enhancer and flow run in one process: in the enhancer's image, whose torchvision has RAFT.
ENHANCE_NETWORK = next((n for n in (config["enhance"]["enhancer"], config["enhance"]["flow"]) if n in MODELS), "")


def section(stage):
    """One stage's section of the configuration. Where survey.force decides on what it has a setting for, the setting follows."""
    values = dict(config[stage])
    if stage == "humans" and "temporal_appearance" in FORCED:
        values["temporal"] = values["temporal"] | {"use": "always" if FORCED["temporal_appearance"] == "on" else "never"}
    if stage == "enhance" and FORCED.get("enhancement") == "off":
        values["enhancer"] = "none"
    if stage == "enhance" and FORCED.get("injection") == "off":
        values["injection"] = values["injection"] | {"history": 0}
    return values


def settings(step):
    """What one step is told of the configuration as JSON: the settings that it reads, so that a change of another one is none of its."""
    return json.dumps(told(step, section(step.partition(".")[0])), sort_keys=True)


def shot_settings(step, *keys):
    """Function that tells a step of one shot the same, with of render.shots this shot alone; of that, ``keys``, or all that makes the film."""

    def of_shot(wildcards):
        own = {k: v for k, v in config["render"]["shots"].get(wildcards.shot, {}).items() if (k in keys if keys else k != "reference")}
        return json.dumps(told(step, section("render")) | {"shots": {wildcards.shot: own} if own else {}}, sort_keys=True)

    return of_shot


def shown_settings():
    """What the page shows: all settings but those that say how to run, not what comes out."""
    return {k: v for k, v in config.items() if k not in ("sweep", "sweep_minutes", "images")}


def code(step):
    """Digest of the code a step imports from this package, so that an edited line re-runs it."""
    return package_code.digest(step)


def in_dataset(path):
    """A file of the dataset: a made studio's is a result like others, a user's own lies where it lies, whatever storage results go to."""
    return str(path) if STUDIO else local(str(path))


def image(name):
    """A container image: the file that snakemake images made with apptainer, else its address from envs/images.yaml."""
    entry = IMAGES[name]
    built = Path(config["images"]) / f"{name}-{entry['version']}.sif"
    if built.is_file():
        return str(built)
    return f"docker://{entry['image']}@{entry['digest']}" if entry["digest"] else f"docker://{entry['image']}:{entry['version']}"


def no_container(wildcards):
    """For a rule that must run outside of images whatever --sdm says; the linter wants every rule to say something."""
    return None


def model_image(name):
    """The image an upstream network runs in."""
    return image(MODELS[name].runtime.image)


# What draws Gaussians on a GPU and what LPIPS needs is in an image of its own, because torch is large.
DRAWN_BY = "vision" if config["device"] == "cuda" or {"lpips", "lpips_alex"} & set(SELECTED) else "core"
DRAWING_GPUS = 1 if config["device"] == "cuda" else 0
IMAGES_USED = sorted({"core", DRAWN_BY} | {MODELS[name].runtime.image for name in SELECTED})


def gpus(name):
    """GPUs that a job of an upstream network holds: one, unless everything is to run on the CPU or the network needs none."""
    return 0 if config["device"] == "cpu" or MODELS[name].memory.gpu_gb is None else 1


def brought(folder, stem, suffixes, setting):
    """A file of upstream's that the user brought, by its conventional name; a sentence when it is not there."""
    found = [path for suffix in suffixes if (path := Path(folder) / f"{stem}{suffix}").exists()]
    if not found:
        raise WorkflowError(f"{setting} is {folder!r}, which has no {stem} with one of the endings {', '.join(suffixes)}")
    return local(str(found[0]))


def estimated_depth(wildcards):
    """Depth of one camera in any unit: a network's, or the file that the user brought."""
    if DEPTH_NETWORK != "precomputed":
        return f"results/{wildcards.scene}/depth/{wildcards.camera}.estimate.exr"
    return brought(config["depth"]["precomputed"], wildcards.camera, (".exr", ".npy", ".npz", ".png"), "depth.precomputed")


def generated_film(wildcards):
    """Film of one segment's views: the network's, or the file that the user brought."""
    if SYNTHESIZER != "precomputed":
        return f"results/{wildcards.scene}/views/{wildcards.segment}.film.mkv"
    return brought(config["views"]["precomputed"], wildcards.segment, (".mkv", ".mp4"), "views.precomputed")


def people(wildcards):
    """Ids of the people that association found; none, without asking, when the dataset says the room is empty."""
    if not DATASET.people:
        return []
    table = Path(checkpoints.people_associate.get(scene=wildcards.scene).output.people)
    return read_people(table)


def fits(wildcards):
    """Body file of every person."""
    return [f"results/{wildcards.scene}/people/{p}.npz" for p in people(wildcards)]


def walkers(wildcards):
    """Bodies of the people whose ways are kept free of furniture; none unless depth.solids_walked asks for them."""
    return fits(wildcards) if config["depth"]["solids_walked"] else []


def sightings(wildcards):
    """What cameras saw of those people, which nothing can stand in front of."""
    return detections(wildcards) if walkers(wildcards) else []


def sighted(wildcards):
    """Whose those sightings are."""
    return [f"results/{wildcards.scene}/people/identities.tsv"] if sightings(wildcards) else []


def tracks_of(wildcards):
    """Which tracks are this person's: a file of their own, so that a change of somebody else's is none of theirs."""
    return f"{checkpoints.people_associate.get(scene=wildcards.scene).output.who}/{wildcards.person}.tsv"


def silhouettes_of(wildcards):
    """Silhouettes of this person, if no keypoints are there."""
    return f"{checkpoints.people_associate.get(scene=wildcards.scene).output.who}/{wildcards.person}.npz"


def human_gaussians(wildcards):
    """Canonical Gaussians of every person."""
    return [f"results/{wildcards.scene}/humans/{p}.ply" for p in people(wildcards)]


def human_avatars(wildcards):
    """Skinning and motion of every person."""
    return [f"results/{wildcards.scene}/humans/{p}.npz" for p in people(wildcards)]


def verdict(effect, wildcards):
    """What the survey says of one effect: on, off or undetermined; without asking it where survey.force has said so."""
    if effect in FORCED:
        return FORCED[effect]
    decided = json.loads(Path(checkpoints.survey_decide.get(scene=wildcards.scene).output.decisions).read_text())
    return next(d["verdict"] for d in decided["decisions"] if d["effect"] == effect)


def gains(wildcards):
    """What the cameras' exposures are divided by: a file, where the survey calls for it."""
    return [f"results/{wildcards.scene}/survey/gains.json"] if verdict("exposure", wildcards) == "on" else []


def gloss(wildcards):
    """A file where the survey calls for colours that change with the direction of view."""
    return [f"results/{wildcards.scene}/survey/gloss.json"] if verdict("view_dependent_colour", wildcards) == "on" else []


def lights_course(wildcards):
    """What every frame's brightness is divided by: a file, where the survey says that the light changes."""
    return [f"results/{wildcards.scene}/survey/course.json"] if verdict("changing_light", wildcards) == "on" else []


def synthesized(ending):
    """Function that names the views of every segment (mkv) or their masks (mask.mkv); none unless the survey calls for views."""

    def paths(wildcards):
        wanted = SEGMENTS if verdict("view_synthesis", wildcards) == "on" else []
        return [f"results/{wildcards.scene}/views/{s}.{ending}" for s in wanted]

    return paths


def loose_objects(wildcards):
    """Loose and held things; none unless the survey finds some."""
    return [f"results/{wildcards.scene}/humans/objects.npz"] if verdict("dynamic_objects", wildcards) == "on" else []


def masks(wildcards):
    """Person masks of every training camera; none when there are no people."""
    if not people(wildcards):
        return []
    return [f"results/{wildcards.scene}/masks/{c}.mkv" for c in TRAINING]


def detections(wildcards):
    """Keypoints of every training camera; none when the room is known to be empty, or only plates show who is there."""
    if not DATASET.people or not SIGHTED:
        return []
    return [f"results/{wildcards.scene}/people/detections/{c}.npz" for c in TRAINING]


def first_detections(wildcards):
    """The same before the second look, which needs cameras that are refined on them; of recorded keypoints there is no second one."""
    if not DATASET.people or not SIGHTED:
        return []
    return [f"results/{wildcards.scene}/people/{'first' if c in DETECTED else 'detections'}/{c}.npz" for c in TRAINING]


def first_detection(wildcards):
    """The same of one camera, if anybody can be there."""
    found = "first" if wildcards.camera in DETECTED else "detections"
    return [f"results/{wildcards.scene}/people/{found}/{wildcards.camera}.npz"] if DATASET.people and SIGHTED else []


def seen_people(wildcards):
    """The detector's masks of one camera, its detections, and who is who; nothing where the detector did not look."""
    if wildcards.camera not in DETECTED:
        return []
    folder = f"results/{wildcards.scene}/people"
    return [f"{folder}/seen/{wildcards.camera}.npz", f"{folder}/detections/{wildcards.camera}.npz", f"{folder}/identities.tsv"]


def people_table(wildcards):
    """The table of people, as an optional input: absent when the room is known to be empty."""
    return [f"results/{wildcards.scene}/people/people.tsv"] if DATASET.people else []


def footage_source(wildcards):
    """Video file or folder of pictures of one camera."""
    return in_dataset(DATASET.footage[wildcards.camera])


def keypoint_source(wildcards):
    """Keypoints of one camera: recorded ones, or what the detector found."""
    if wildcards.camera in DETECTED:
        return f"results/{wildcards.scene}/people/found/{wildcards.camera}.npz"
    return in_dataset(DATASET.keypoints[wildcards.camera])


def given_bodies(wildcards):
    """The user's file of a network's bodies of one camera, if that is where they come from."""
    if BODY_SOURCE != "precomputed":
        return []
    return [brought(config["people"]["precomputed"], wildcards.camera, (".npz", ".pt"), "people.precomputed")]


def given_plate(wildcards):
    """The user's clean plate of one camera, if there is one."""
    return [in_dataset(DATASET.plates[wildcards.camera])] if wildcards.camera in DATASET.plates else []


def given_masks(wildcards):
    """The user's person masks of one camera, if there are any."""
    if wildcards.camera in DATASET.masks:
        return [in_dataset(DATASET.masks[wildcards.camera])]
    if config["masks"]["source"] == "precomputed":
        return [brought(config["masks"]["precomputed"], wildcards.camera, (".mkv", ".mp4", ""), "masks.precomputed")]
    return []


def tracked_masks(wildcards):
    """A network's film of numbers for one camera, where one is asked and the user brought no masks."""
    wanted = MASK_NETWORK and wildcards.camera not in DATASET.masks
    return [f"results/{wildcards.scene}/masks/{wildcards.camera}.tracks.mkv"] if wanted else []


def given_depth(wildcards):
    """The user's depth map of one camera."""
    return in_dataset(DATASET.depth[wildcards.camera])


def shot_path(wildcards):
    """The camera path file that a shot follows, if it is of that kind, and what belongs to it: a COLMAP model is several files."""
    file = config["render"]["shots"].get(wildcards.shot, {}).get("file")
    parts = colmap_files(Path(file)) if file and Path(file).stem == "images" else [file] if file else []
    return [local(str(part)) for part in parts]


def stand_ins(wildcards):
    """Files of the people who stand in for others in a shot; people of this scene are inputs anyway."""
    wanted = config["render"]["shots"].get(wildcards.shot, {}).get("replace", {})
    files = [Path(source) for source in wanted.values() if not re.fullmatch(r"p\d+|nobody", source)]
    return [*map(str, files), *(str(f.with_suffix(".npz")) for f in files if f.with_suffix(".npz").is_file())]


def room_light(wildcards):
    """The light by which people shade the room; none unless the survey calls for moving shadows and somebody is there to throw them."""
    wanted = people(wildcards) and verdict("moving_shadows", wildcards) == "on"
    return [f"results/{wildcards.scene}/render/room.light.json"] if wanted else []


def truth_of_replaced(wildcards):
    """The truth film of a shot in which somebody stands in for a person: photos of that person correct nothing there."""
    replaced = config["render"]["shots"].get(wildcards.shot, {}).get("replace")
    return [f"results/{wildcards.scene}/render/{wildcards.shot}.truth.mkv"] if replaced else []


def edited_reference(wildcards):
    """The edited picture that a network takes as its reference for a shot, if one is named."""
    file = config["render"]["shots"].get(wildcards.shot, {}).get("reference")
    return [local(file)] if file else []


def film_of_elsewhere(wildcards):
    """The film of a shot that was enhanced elsewhere, if that is where films come from."""
    if config["enhance"]["enhancer"] != "precomputed" or FORCED.get("enhancement") == "off":
        return []
    return [brought(config["enhance"]["precomputed"], wildcards.shot, (".mkv", ".mp4"), "enhance.precomputed")]


def every_core(wildcards):
    """All that --cores allows. Asked only when the job is planned: --unlock and --lint are given no number."""
    return workflow.cores


def scene_products():
    """Every stage's product that needs no knowledge of who is in the scene."""
    scene = f"results/{SCENE}"
    return [
        f"{scene}/capture/manifest.json",
        *(f"{scene}/capture/{c}.mkv" for c in CAMERAS),
        *(f"{scene}/capture/{c}.plate.png" for c in TRAINING),
        f"{scene}/cameras/images.txt",
        f"{scene}/cameras/heldout/images.txt",
        f"{scene}/cameras/refinement.json",
        *(f"{scene}/people/detections/{c}.npz" for c in TRAINING if DATASET.people and SIGHTED),
        *(f"{scene}/people/{name}" for name in ("people.tsv", "desk.html") if DATASET.people),
        *(f"{scene}/depth/{c}.exr" for c in TRAINING),
        *(f"{scene}/survey/{name}.json" for name in ("decisions", "gains", "course", "gloss", "trained")),
        f"{scene}/views/path.json",
        f"{scene}/background/scene.ply",
        *(f"{scene}/render/{s}.mkv" for s in SHOTS),
        *(f"{scene}/render/{s}.layers" for s in FILMS if config["render"]["exr"]),
        *(f"{scene}/enhance/{s}.mp4" for s in FILMS),
        *(f"{scene}/enhance/{s}.compare.mp4" for s in FILMS),
        f"{scene}/report/metrics.json",
        f"{scene}/report/index.html",
        f"{scene}/deliver/manifest.json",
    ]


def decided_products(wildcards):
    """Products that hang on who was found and on what the survey decided; known once association and survey have run."""
    found = type("Scene", (), {"scene": SCENE})()
    overlays = [f"results/{SCENE}/people/overlay/{c}.mp4" for c in TRAINING if people(found)]
    persons = [*fits(found), *overlays, *masks(found), *human_gaussians(found), *human_avatars(found)]
    return [*synthesized("mkv")(found), *persons, *loose_objects(found)]
