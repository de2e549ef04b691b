# Static Gaussians of the room.


# What trainings of room and people would each compile by themselves, compiled once, while cameras are looked at and a core is idle.
# The first film that anybody can look at is drawn with some of them, so they come before those of depth.
# The videos only say when: everything that waits for the kernels waits for them too. No input is ancient, though nothing but time depends on these:
# where the job before an ancient input runs, Snakemake does not ask whether the job behind it has a reason of its own, and passes over a changed setting.
rule background_kernels:
    input:
        videos=collect(
            "results/{scene}/capture/{camera}.mkv",
            camera=files.training,
            allow_missing=True,
        ),
    output:
        kernels="results/{scene}/background/kernels.txt",
    log:
        "logs/{scene}/background/kernels.log",
    benchmark:
        "timings/{scene}/background/kernels.tsv"
    priority: 1
    container:
        image(PLAN.networks.rasteriser_image)
    threads: 8 if PLAN.networks.rasteriser_gpus else 1  # gsplat has 29 sources for nvcc
    resources:
        mem_mb=memory(drawn_mb(PLAN, 1500, compilers=8)),
        gpu=PLAN.networks.rasteriser_gpus,
    params:
        code=code("background.kernels"),
        device=config["device"],
    shell:
        command("background.kernels")


# What the room is trained on, in one job or in two halves.
ROOM = {
    "model": MODEL,
    "plates": collect(
        "results/{scene}/plates/{camera}.png",
        camera=files.training,
        allow_missing=True,
    ),
    "depths": collect(
        "results/{scene}/depth/{camera}.exr",
        camera=files.training,
        allow_missing=True,
    ),
    "room_box": "results/{scene}/depth/room.json",
    "gains": files.gains,
    "specularity": files.specularity,
    "path": "results/{scene}/views/path.json",
    "views": files.views,
    "supports": files.view_masks,
    "videos": files.first_pictures,
    "masks": files.first_masks,
}


if PLAN.networks.refiner:

    # Half-way a network repairs views of the room: it has an image and a GPU of its own, so the training is two jobs with the network's between.
    rule background_half:
        input:
            **ROOM,
            kernels="results/{scene}/background/kernels.txt",
        output:
            half="results/{scene}/background/half.ply",
            provenance="results/{scene}/background/half.npz",
            renders="results/{scene}/background/half.mkv",
            renders_path="results/{scene}/background/half.json",
        log:
            "logs/{scene}/background/half.log",
        benchmark:
            "timings/{scene}/background/half.tsv"
        container:
            image(PLAN.networks.rasteriser_image)
        threads: 2
        resources:
            mem_mb=memory(room_mb(PLAN, config)),
            gpu=PLAN.networks.rasteriser_gpus,
        params:
            settings=settings("background.half"),
            code=code("background.half"),
            device=config["device"],
            working="logs/{scene}/background/half",
            lpips=PLAN.networks.lpips("background"),
        shell:
            command("background.half")

    rule background_refined:
        input:
            renders="results/{scene}/background/half.mkv",
            renders_path="results/{scene}/background/half.json",
            model=MODEL,
            plates=collect(
                "results/{scene}/plates/{camera}.png",
                camera=files.training,
                allow_missing=True,
            ),
            gains=files.gains,
        output:
            refined="results/{scene}/background/refined.mkv",
        log:
            "logs/{scene}/background/refined.log",
        benchmark:
            "timings/{scene}/background/refined.tsv"
        container:
            model_image(PLAN.networks.refiner)
        threads: 2
        resources:
            mem_mb=memory(16000),
            gpu=gpus(PLAN.networks.refiner),
        params:
            code=code("background.refined"),
            enhancer=PLAN.networks.refiner,
            injection=step_config.recursion_settings(config),
            flow=config["enhance"]["flow"],
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("background.refined")


rule background_train:
    input:
        **ROOM,
        half=files.half_trained,
        kernels="results/{scene}/background/kernels.txt",
    output:
        background="results/{scene}/background/scene.ply",
        provenance="results/{scene}/background/provenance.npz",
    log:
        "logs/{scene}/background/train.log",
    benchmark:
        "timings/{scene}/background/train.tsv"
    priority: 5
    container:
        image(PLAN.networks.rasteriser_image)
    threads: threads_beside(2)  # people are trained meanwhile
    resources:
        mem_mb=memory(room_mb(PLAN, config)),
        gpu=PLAN.networks.rasteriser_gpus,
    params:
        settings=settings("background.train"),
        code=code("background.train"),
        device=config["device"],
        working="logs/{scene}/background/train",
        lpips=PLAN.networks.lpips("background"),
    message:
        "Train the room of {wildcards.scene}; previews are in {params.working}"
    shell:
        command("background.train")
