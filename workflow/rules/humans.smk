# One person as Gaussians that the body moves.


rule humans_train:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        people="results/{scene}/people/people.tsv",
        videos=collect(
            "results/{scene}/capture/{camera}.mkv",
            camera=TRAINING,
            allow_missing=True,
        ),
        masks=collect(
            "results/{scene}/masks/{camera}.mkv",
            camera=TRAINING,
            allow_missing=True,
        ),
        fit="results/{scene}/people/{person}.npz",
        body=BODY,
        gains=gains,
        light=lights_course,
    output:
        gaussians="results/{scene}/humans/{person}.ply",
        avatar="results/{scene}/humans/{person}.npz",
    log:
        "logs/{scene}/humans/train/{person}.log",
    benchmark:
        "benchmarks/{scene}/humans/train/{person}.tsv"
    container:
        image(DRAWN_BY)
    threads: 1
    resources:
        mem_mb=3000,
        gpu=DRAWING_GPUS,
    params:
        settings=settings("humans.train"),
        code=code("humans.train"),
        device=config["device"],
    shell:
        "python -m studiorecon humans.train --settings {params.settings:q} --log {log} --device {params.device}"
        " --person {wildcards.person} --model {input.model[0]:q} --manifest {input.manifest} --people {input.people}"
        " --videos {input.videos:q} --masks {input.masks:q} --fit {input.fit} --body {input.body}"
        " --threads {threads} --gaussians {output.gaussians} --avatar {output.avatar}"
        " --exposure {input.gains:q} {input.light:q} --previews logs/{wildcards.scene}/humans/train/{wildcards.person}"


# On request: snakemake results/SCENE/humans/p00.canonical.ply makes a rest-pose person with LHM, from the best photo of them.
rule humans_canonical:
    input:
        people="results/{scene}/people/people.tsv",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        masks=collect("results/{scene}/masks/{camera}.mkv", camera=TRAINING, allow_missing=True),
    output:
        gaussians="results/{scene}/humans/{person}.canonical.ply",
        photo="results/{scene}/humans/{person}.photo.png",
    log:
        "logs/{scene}/humans/canonical/{person}.log",
    benchmark:
        "benchmarks/{scene}/humans/canonical/{person}.tsv"
    container:
        model_image("lhm")
    threads: 4
    resources:
        mem_mb=32000,
        gpu=1,
    params:
        code=code("humans.canonical"),
        weights=WEIGHTS,
    shell:
        "python -m studiorecon humans.canonical --log {log} --person {wildcards.person} --people {input.people}"
        " --videos {input.videos:q} --masks {input.masks:q} --weights {params.weights:q}"
        " --gaussians {output.gaussians} --photo {output.photo}"


# On request, or where a film's replace names it: the bare body of a person's build, chequered.
rule humans_plain:
    input:
        fit="results/{scene}/people/{person}.npz",
        body=BODY,
    output:
        gaussians="results/{scene}/humans/{person}.plain.ply",
    log:
        "logs/{scene}/humans/plain/{person}.log",
    benchmark:
        "benchmarks/{scene}/humans/plain/{person}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        settings=settings("humans.plain"),
        code=code("humans.plain"),
    shell:
        "python -m studiorecon humans.plain --settings {params.settings:q} --log {log}"
        " --body {input.body:q} --fit {input.fit:q} --gaussians {output.gaussians:q}"


# Where the survey finds things that move: what they are and where they go, from what no body explains.
rule humans_objects:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
        people=fits,
        body=BODY,
        gains=gains,
        light=lights_course,
    output:
        objects="results/{scene}/humans/objects.npz",
    log:
        "logs/{scene}/humans/objects.log",
    benchmark:
        "benchmarks/{scene}/humans/objects.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("humans.objects"),
        code=code("humans.objects"),
    shell:
        "python -m studiorecon humans.objects --settings {params.settings:q} --log {log:q} --model {input.model[0]:q}"
        " --manifest {input.manifest:q} --videos {input.videos:q} --plates {input.plates:q} --people {input.people:q}"
        " --body {input.body:q} --gains {input.gains:q} --light {input.light:q} --threads {threads} --objects {output.objects:q}"
