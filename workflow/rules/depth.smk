# Depth of the static scene: every camera looks for planes, the room is fitted to what they found, every camera looks again.
# A depth map the user brought takes the place of the last look; a network's (depth.source) is put to the scale of that look.

import re


ruleorder: depth_given > depth_refine


if DEPTH_NETWORK:

    ruleorder: depth_given > depth_aligned


rule depth_sweep:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/capture/{other}.plate.png",
            other=TRAINING,
            allow_missing=True,
        ),
    output:
        sweep="results/{scene}/depth/{camera}.sweep.npz",
    log:
        "logs/{scene}/depth/sweep/{camera}.log",
    benchmark:
        "benchmarks/{scene}/depth/sweep/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("depth.sweep"),
        code=code("depth.sweep"),
    shell:
        "python -m studiorecon depth.sweep --settings {params.settings:q} --log {log}"
        " --camera {wildcards.camera:q} --model {input.model[0]:q} --plates {input.plates:q} --sweep {output.sweep:q}"


rule depth_shell:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/capture/{other}.plate.png",
            other=TRAINING,
            allow_missing=True,
        ),
        sweeps=collect(
            "results/{scene}/depth/{other}.sweep.npz",
            other=TRAINING,
            allow_missing=True,
        ),
        people=walkers,
        detections=sightings,
        identities=sighted,
    output:
        shell="results/{scene}/depth/shell.json",
        solids="results/{scene}/depth/solids.json",
        picture="results/{scene}/depth/solids.png",
        passes="results/{scene}/depth/passes.npz",
    log:
        "logs/{scene}/depth/shell.log",
    benchmark:
        "benchmarks/{scene}/depth/shell.tsv"
    container:
        image("core")
    threads: 2
    resources:
        mem_mb=2500,
    params:
        settings=settings("depth.shell"),
        code=code("depth.shell"),
    shell:
        "python -m studiorecon depth.shell --settings {params.settings:q} --log {log}"
        " --model {input.model[0]:q} --plates {input.plates:q} --sweeps {input.sweeps:q} --people {input.people:q}"
        " --detections {input.detections:q} --identities {input.identities:q} --shell {output.shell}"
        " --solids {output.solids} --picture {output.picture} --passes {output.passes}"


rule depth_refine:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/capture/{other}.plate.png",
            other=TRAINING,
            allow_missing=True,
        ),
        shell="results/{scene}/depth/shell.json",
        solids="results/{scene}/depth/solids.json",
        passes="results/{scene}/depth/passes.npz",
    output:
        depth="results/{scene}/depth/{camera}.planes.exr" if DEPTH_NETWORK else "results/{scene}/depth/{camera}.exr",
    log:
        "logs/{scene}/depth/refine/{camera}.log",
    benchmark:
        "benchmarks/{scene}/depth/refine/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("depth.refine"),
        code=code("depth.refine"),
    shell:
        "python -m studiorecon depth.refine --settings {params.settings:q} --log {log}"
        " --camera {wildcards.camera:q} --model {input.model[0]:q} --plates {input.plates:q} --passes {input.passes}"
        " --shell {input.shell} --solids {input.solids} --depth {output.depth:q}"


rule depth_given:
    input:
        model=MODEL,
        source=given_depth,
    output:
        depth="results/{scene}/depth/{camera}.exr",
    log:
        "logs/{scene}/depth/given/{camera}.log",
    benchmark:
        "benchmarks/{scene}/depth/given/{camera}.tsv"
    wildcard_constraints:
        camera="|".join(map(re.escape, DATASET.depth)) or "(?!)",
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("depth.given"),
        code=code("depth.given"),
    shell:
        "python -m studiorecon depth.given --settings {params.settings:q} --log {log}"
        " --camera {wildcards.camera:q} --model {input.model[0]:q} --source {input.source:q} --depth {output.depth:q}"


if DEPTH_NETWORK in MODELS:

    rule depth_network:
        input:
            model=MODEL,
            plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
        output:
            depths=collect("results/{scene}/depth/{camera}.estimate.exr", camera=TRAINING, allow_missing=True),
        log:
            "logs/{scene}/depth/network.log",
        benchmark:
            "benchmarks/{scene}/depth/network.tsv"
        container:
            model_image(DEPTH_NETWORK)
        threads: 1
        resources:
            mem_mb=16000,
            gpu=gpus(DEPTH_NETWORK),
        params:
            settings=settings("depth.network"),
            code=code("depth.network"),
            weights=WEIGHTS,
            device=config["device"],
        shell:
            "python -m studiorecon depth.network --settings {params.settings:q} --log {log}"
            " --model {input.model[0]:q} --plates {input.plates:q} --weights {params.weights:q} --device {params.device}"
            " --depths {output.depths:q}"


if DEPTH_NETWORK:

    rule depth_aligned:
        input:
            model=MODEL,
            estimate=estimated_depth,
            planes="results/{scene}/depth/{camera}.planes.exr",
        output:
            depth="results/{scene}/depth/{camera}.exr",
        log:
            "logs/{scene}/depth/aligned/{camera}.log",
        benchmark:
            "benchmarks/{scene}/depth/aligned/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=1000,
        params:
            settings=settings("depth.aligned"),
            code=code("depth.aligned"),
        shell:
            "python -m studiorecon depth.aligned --settings {params.settings:q} --log {log}"
            " --camera {wildcards.camera:q} --model {input.model[0]:q} --estimate {input.estimate:q} --planes {input.planes:q}"
            " --depth {output.depth:q}"
