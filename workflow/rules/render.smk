# Films of the 4D scene: one composite rasterisation per picture.


# Where the survey finds moving shadows: what light throws them, from the floor beside people.
rule render_light:
    input:
        model=MODEL,
        people=fits,
        body=BODY,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        masks=masks,
        plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
        shell="results/{scene}/depth/shell.json",
    output:
        light="results/{scene}/render/room.light.json",
    log:
        "logs/{scene}/render/light.log",
    benchmark:
        "benchmarks/{scene}/render/light.tsv"
    container:
        image("core")
    threads: 2
    resources:
        mem_mb=3000,
    params:
        settings=settings("render.light"),
        code=code("render.light"),
    shell:
        "python -m studiorecon render.light --settings {params.settings:q} --log {log:q} --model {input.model[0]:q}"
        " --people {input.people:q} --body {input.body:q} --videos {input.videos:q} --masks {input.masks:q}"
        " --plates {input.plates:q} --depths {input.depths:q} --shell {input.shell:q} --light {output.light:q}"


rule render_shot:
    input:
        model=MODEL,
        heldout_model=HELDOUT_MODEL,
        manifest="results/{scene}/capture/manifest.json",
        background="results/{scene}/background/scene.ply",
        provenance="results/{scene}/background/provenance.npz",
        gaussians=human_gaussians,
        avatars=human_avatars,
        body=BODY,
        # Camera paths that shots follow: an edited path makes its film again.
        followed=shot_path,
        # Who stands in for whom: a new file of theirs makes the film again.
        stand_ins=stand_ins,
        light=room_light,
        objects=loose_objects,
    output:
        video="results/{scene}/render/{shot}.mkv",
        truth="results/{scene}/render/{shot}.truth.mkv",
        depth="results/{scene}/render/{shot}.depth.mkv",
        path="results/{scene}/render/{shot}.json",
        ledger="results/{scene}/render/{shot}.tsv",
    log:
        "logs/{scene}/render/shot/{shot}.log",
    benchmark:
        "benchmarks/{scene}/render/shot/{shot}.tsv"
    container:
        image(DRAWN_BY)
    threads: 2
    resources:
        mem_mb=2000,
        gpu=DRAWING_GPUS,
    params:
        settings=shot_settings("render.shot"),
        code=code("render.shot"),
        device=config["device"],
    shell:
        "python -m studiorecon render.shot --settings {params.settings:q} --log {log} --device {params.device}"
        " --shot {wildcards.shot} --model {input.model[0]:q} --heldout-model {input.heldout_model[0]:q} --manifest {input.manifest}"
        " --background {input.background} --provenance {input.provenance} --gaussians {input.gaussians:q}"
        " --avatars {input.avatars:q} --body {input.body} --light {input.light:q} --objects {input.objects:q}"
        " --video {output.video} --truth {output.truth} --depth {output.depth} --path {output.path}"
        " --ledger {output.ledger}"


# With render.exr, or on request: snakemake results/SCENE/render/orbit.layers takes a film apart for compositing.
rule render_layers:
    input:
        path="results/{scene}/render/{shot}.json",
        background="results/{scene}/background/scene.ply",
        provenance="results/{scene}/background/provenance.npz",
        gaussians=human_gaussians,
        avatars=human_avatars,
        body=BODY,
        stand_ins=stand_ins,
        light=room_light,
        objects=loose_objects,
    output:
        folder=directory("results/{scene}/render/{shot}.layers"),
    log:
        "logs/{scene}/render/layers/{shot}.log",
    benchmark:
        "benchmarks/{scene}/render/layers/{shot}.tsv"
    container:
        image(DRAWN_BY)
    threads: 2
    resources:
        mem_mb=2000,
        gpu=DRAWING_GPUS,
    params:
        settings=shot_settings("render.layers", "replace"),
        code=code("render.layers"),
        device=config["device"],
    shell:
        "python -m studiorecon render.layers --settings {params.settings:q} --log {log} --device {params.device}"
        " --shot {wildcards.shot} --path {input.path:q} --background {input.background:q} --provenance {input.provenance:q}"
        " --gaussians {input.gaussians:q} --avatars {input.avatars:q} --body {input.body:q} --light {input.light:q}"
        " --objects {input.objects:q} --folder {output.folder:q}"
