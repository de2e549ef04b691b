# Films that do not flicker: every picture through the enhancer, earlier outputs injected.


rule enhance_shot:
    input:
        render="results/{scene}/render/{shot}.mkv",
        render_path="results/{scene}/render/{shot}.json",
        render_depth="results/{scene}/render/{shot}.depth.mkv",
        train="results/{scene}/render/train.mkv",
        train_path="results/{scene}/render/train.json",
        train_depth="results/{scene}/render/train.depth.mkv",
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        truth=truth_of_replaced,
        edited=edited_reference,
        made=film_of_elsewhere,
        gains=gains,
        light=lights_course,
    output:
        video="results/{scene}/enhance/{shot}.mkv",
        film="results/{scene}/enhance/{shot}.mp4",
    log:
        "logs/{scene}/enhance/shot/{shot}.log",
    benchmark:
        "benchmarks/{scene}/enhance/shot/{shot}.tsv"
    container:
        model_image(ENHANCE_NETWORK) if ENHANCE_NETWORK else image("core")
    threads: 2
    resources:
        mem_mb=1500,
        gpu=gpus(ENHANCE_NETWORK) if ENHANCE_NETWORK else 0,
    params:
        settings=settings("enhance.shot"),
        code=code("enhance.shot"),
        weights=WEIGHTS if ENHANCE_NETWORK else "none",
        device=config["device"] if ENHANCE_NETWORK else "cpu",
    shell:
        "python -m studiorecon enhance.shot --settings {params.settings:q} --log {log}"
        " --weights {params.weights:q} --device {params.device}"
        " --shot {wildcards.shot} --render {input.render:q} --render-path {input.render_path:q} --render-depth {input.render_depth}"
        " --train {input.train} --train-path {input.train_path} --train-depth {input.train_depth}"
        " --model {input.model[0]:q} --manifest {input.manifest} --videos {input.videos:q}"
        " --truth {input.truth:q} --edited {input.edited:q} --made {input.made:q} --exposure {input.gains:q} {input.light:q} --video {output.video} --film {output.film}"


# On request: snakemake results/SCENE/enhance/orbit.37.steps.png shows how picture 37 was made.
rule enhance_sheet:
    input:
        render="results/{scene}/render/{shot}.mkv",
        render_path="results/{scene}/render/{shot}.json",
        video="results/{scene}/enhance/{shot}.mkv",
    output:
        image="results/{scene}/enhance/{shot}.{picture}.steps.png",
    log:
        "logs/{scene}/enhance/sheet/{shot}.{picture}.log",
    benchmark:
        "benchmarks/{scene}/enhance/sheet/{shot}.{picture}.tsv"
    container:
        model_image(ENHANCE_NETWORK) if ENHANCE_NETWORK else image("core")
    threads: 1
    resources:
        mem_mb=800,
        gpu=gpus(ENHANCE_NETWORK) if ENHANCE_NETWORK else 0,
    params:
        settings=settings("enhance.sheet"),
        code=code("enhance.sheet"),
        weights=WEIGHTS if ENHANCE_NETWORK else "none",
        device=config["device"] if ENHANCE_NETWORK else "cpu",
    shell:
        "python -m studiorecon enhance.sheet --settings {params.settings:q} --log {log}"
        " --weights {params.weights:q} --device {params.device}"
        " --shot {wildcards.shot} --picture {wildcards.picture} --render {input.render:q} --render-path {input.render_path:q}"
        " --video {input.video:q} --image {output.image:q}"


rule enhance_comparison:
    input:
        render="results/{scene}/render/{shot}.mkv",
        render_path="results/{scene}/render/{shot}.json",
        video="results/{scene}/enhance/{shot}.mkv",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=CAMERAS, allow_missing=True),
    output:
        beside="results/{scene}/enhance/{shot}.compare.mp4",
        wipe="results/{scene}/enhance/{shot}.wipe.mp4",
    log:
        "logs/{scene}/enhance/comparison/{shot}.log",
    benchmark:
        "benchmarks/{scene}/enhance/comparison/{shot}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("enhance.comparison"),
        code=code("enhance.comparison"),
    shell:
        "python -m studiorecon enhance.comparison --settings {params.settings:q} --log {log}"
        " --shot {wildcards.shot} --render {input.render:q} --render-path {input.render_path:q} --video {input.video:q}"
        " --videos {input.videos:q} --beside {output.beside:q} --wipe {output.wipe:q}"
