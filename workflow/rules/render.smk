# Films of the 4D scene: one composite rasterisation per picture.


# Where the survey finds moving shadows: what light throws them, from the floor beside people.
rule render_light:
    input:
        model=MODEL,
        fits=files.fits,
        body=files.body,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        masks=files.masks,
        plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=files.training, allow_missing=True),
        room_box="results/{scene}/depth/room.json",
    output:
        light="results/{scene}/render/room.light.json",
    log:
        "logs/{scene}/render/light.log",
    benchmark:
        "timings/{scene}/render/light.tsv"
    container:
        image("core")
    threads: 2
    resources:
        mem_mb=memory(3000),
    params:
        settings=settings("render.light"),
        code=code("render.light"),
    shell:
        command("render.light")


rule render_shot:
    input:
        **TRAINED,
        # Camera paths that shots follow: an edited path makes its film again.
        model=MODEL,
        heldout_model=HELDOUT_MODEL,
        manifest="results/{scene}/capture/manifest.json",
        followed=files.shot_path,
        # Who stands in for whom: a new file of theirs makes the film again.
        stand_ins=files.replacement_people,
        light=files.room_light,
    output:
        video="results/{scene}/render/{shot}.mkv",
        truth="results/{scene}/render/{shot}.truth.mkv",
        depth="results/{scene}/render/{shot}.depth.mkv",
        path="results/{scene}/render/{shot}.json",
        ledger="results/{scene}/render/{shot}.tsv",
    log:
        "logs/{scene}/render/shot/{shot}.log",
    benchmark:
        "timings/{scene}/render/shot/{shot}.tsv"
    # Before what shows the scene otherwise, and is read later.
    priority: 10
    container:
        image(PLAN.networks.rasteriser_image)
    threads: threads_beside(len(PLAN.shots))
    resources:
        mem_mb=memory(drawn_mb(PLAN, 2000)),
        gpu=PLAN.networks.rasteriser_gpus,
    params:
        settings=shot_settings("render.shot"),
        code=code("render.shot"),
        device=config["device"],
    message:
        "Render film {wildcards.shot}"
    shell:
        command("render.shot")


# With render.exr, or on request: snakemake results/SCENE/render/orbit.layers takes a film apart for compositing.
rule render_layers:
    input:
        **TRAINED,
        path="results/{scene}/render/{shot}.json",
        stand_ins=files.replacement_people,
        light=files.room_light,
    output:
        folder=directory("results/{scene}/render/{shot}.layers"),
    log:
        "logs/{scene}/render/layers/{shot}.log",
    benchmark:
        "timings/{scene}/render/layers/{shot}.tsv"
    container:
        image(PLAN.networks.rasteriser_image)
    threads: 2
    resources:
        mem_mb=memory(drawn_mb(PLAN, 2000)),
        gpu=PLAN.networks.rasteriser_gpus,
    params:
        settings=shot_settings("render.layers", "replace"),
        code=code("render.layers"),
        device=config["device"],
    shell:
        command("render.layers")


# Where shadows are thrown: how much light they leave, for what is drawn elsewhere.
rule render_shade:
    input:
        **TRAINED,
        manifest="results/{scene}/capture/manifest.json",
        light="results/{scene}/render/room.light.json",
    output:
        shade="results/{scene}/render/room.shade.npz",
    log:
        "logs/{scene}/render/shade.log",
    benchmark:
        "timings/{scene}/render/shade.tsv"
    container:
        image("core")
    threads: 2
    resources:
        mem_mb=memory(1500),
    params:
        code=code("render.shade"),
    shell:
        command("render.shade")
