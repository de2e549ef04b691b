# One person as Gaussians that the body moves.


rule humans_train:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        people="results/{scene}/people/people.tsv",
        videos=collect(
            "results/{scene}/capture/{camera}.mkv",
            camera=files.training,
            allow_missing=True,
        ),
        masks=collect(
            "results/{scene}/masks/{camera}.mkv",
            camera=files.training,
            allow_missing=True,
        ),
        fit="results/{scene}/people/{person}.npz",
        body=files.body,
        exposure=files.exposure,
        kernels="results/{scene}/background/kernels.txt",
    output:
        gaussians="results/{scene}/humans/{person}.ply",
        avatar="results/{scene}/humans/{person}.npz",
    log:
        "logs/{scene}/humans/train/{person}.log",
    benchmark:
        "timings/{scene}/humans/train/{person}.tsv"
    container:
        image(PLAN.networks.rasteriser_image)
    threads: 1
    resources:
        mem_mb=memory(drawn_mb(PLAN, 3000)),
        gpu=PLAN.networks.rasteriser_gpus,
    params:
        settings=settings("humans.train"),
        code=code("humans.train"),
        device=config["device"],
        working="logs/{scene}/humans/train/{person}",
        lpips=PLAN.networks.lpips("humans"),
    message:
        "Train person {wildcards.person}; previews are in {params.working}"
    shell:
        command("humans.train")


# On request, for humans_canonical: the best photo that the capture has of a person.
rule humans_photo:
    input:
        people="results/{scene}/people/people.tsv",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        masks=collect("results/{scene}/masks/{camera}.mkv", camera=files.training, allow_missing=True),
    output:
        photo="results/{scene}/humans/{person}.photo.png",
    log:
        "logs/{scene}/humans/photo/{person}.log",
    benchmark:
        "timings/{scene}/humans/photo/{person}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        code=code("humans.photo"),
    shell:
        command("humans.photo")


# Where a film's replace names a photo: the person of it, cut out.
rule humans_stranger:
    input:
        photo=files.replacement_photo,
        networks=files.detector,
    output:
        cut="results/{scene}/humans/{stranger}.photo.png",
    log:
        "logs/{scene}/humans/stranger/{stranger}.log",
    benchmark:
        "timings/{scene}/humans/stranger/{stranger}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(2000),
    params:
        code=code("humans.stranger"),
    shell:
        command("humans.stranger")


# Where a film's replace names a photo, or on request (snakemake results/SCENE/humans/p0.canonical.ply): a rest-pose person
# with LHM, from one photo.
rule humans_canonical:
    input:
        photo="results/{scene}/humans/{donor}.photo.png",
    output:
        gaussians="results/{scene}/humans/{donor}.canonical.ply",
    log:
        "logs/{scene}/humans/canonical/{donor}.log",
    benchmark:
        "timings/{scene}/humans/canonical/{donor}.tsv"
    container:
        model_image("lhm")
    threads: 4
    resources:
        mem_mb=memory(32000),
        gpu=1,
    params:
        code=code("humans.canonical"),
        weights=PLAN.networks.weights,
    shell:
        command("humans.canonical")


# On request, or where a film's replace names it: the bare body of a person's build, chequered.
rule humans_proxy:
    input:
        fit="results/{scene}/people/{person}.npz",
        body=files.body,
    output:
        gaussians="results/{scene}/humans/{person}.plain.ply",
    log:
        "logs/{scene}/humans/proxy/{person}.log",
    benchmark:
        "timings/{scene}/humans/proxy/{person}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        settings=settings("humans.proxy"),
        code=code("humans.proxy"),
    shell:
        command("humans.proxy")


# SMPL's own pickle as plain arrays, which every step reads.
if files.body != files.given_body:

    rule body_plain:
        input:
            pickle=files.given_body,
        output:
            body=files.body,
        log:
            "logs/body/plain.log",
        benchmark:
            "timings/body/plain.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(1000),
        params:
            code=code("models.smpl"),
        shell:
            command("models.smpl")
