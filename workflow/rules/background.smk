# Static Gaussians of the room.


rule background_train:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/capture/{camera}.plate.png",
            camera=TRAINING,
            allow_missing=True,
        ),
        depth=collect(
            "results/{scene}/depth/{camera}.exr",
            camera=TRAINING,
            allow_missing=True,
        ),
        shell="results/{scene}/depth/shell.json",
        exposure=gains,
        gloss=gloss,
        path="results/{scene}/views/path.json",
        views=synthesized("mkv"),
        supports=synthesized("mask.mkv"),
    output:
        background="results/{scene}/background/scene.ply",
        provenance="results/{scene}/background/provenance.npz",
    log:
        "logs/{scene}/background/train.log",
    benchmark:
        "benchmarks/{scene}/background/train.tsv"
    container:
        image(DRAWN_BY)
    threads: 2
    resources:
        mem_mb=3000,
        gpu=DRAWING_GPUS,
    params:
        settings=settings("background.train"),
        code=code("background.train"),
        device=config["device"],
    shell:
        "python -m studiorecon background.train --settings {params.settings:q} --log {log} --device {params.device}"
        " --model {input.model[0]:q} --plates {input.plates:q} --depth {input.depth:q} --shell {input.shell}"
        " --path {input.path} --views {input.views:q} --supports {input.supports:q}"
        " --threads {threads} --background {output.background} --provenance {output.provenance}"
        " --exposure {input.exposure:q} --gloss {input.gloss:q} --previews logs/{wildcards.scene}/background/train"
