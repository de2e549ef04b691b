# Depth of the static scene: every camera looks for planes, the room is fitted to what they found, every camera looks again.
# A depth map the user brought takes the place of the last look; a network's (depth.source) is one term of it.


ruleorder: depth_given > depth_refine


if PLAN.networks.first_depth:

    ruleorder: depth_given > depth_first > depth_refine


rule depth_sweep:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/plates/{other}.png",
            other=files.training,
            allow_missing=True,
        ),
    output:
        sweep="results/{scene}/depth/{camera}.sweep.npz",
    log:
        "logs/{scene}/depth/sweep/{camera}.log",
    benchmark:
        "timings/{scene}/depth/sweep/{camera}.tsv"
    # The first film that anybody can look at waits for it, and then the furniture.
    priority: 7
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("depth.sweep"),
        code=code("depth.sweep"),
    shell:
        command("depth.sweep")


# What the fit of the room would compile by itself, with every later step waiting for it, compiled while people are found: not earlier,
# or both cores would compile before cameras are looked at.
rule depth_kernels:
    input:
        model=MODEL,
    output:
        kernels="results/{scene}/depth/kernels.txt",
    log:
        "logs/{scene}/depth/kernels.log",
    benchmark:
        "timings/{scene}/depth/kernels.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        code=code("depth.kernels"),
    shell:
        command("depth.kernels")


rule depth_box:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/plates/{other}.png",
            other=files.training,
            allow_missing=True,
        ),
        sweeps=collect(
            "results/{scene}/depth/{other}.sweep.npz",
            other=files.training,
            allow_missing=True,
        ),
    output:
        box="results/{scene}/depth/box.json",
    log:
        "logs/{scene}/depth/box.log",
    benchmark:
        "timings/{scene}/depth/box.tsv"
    priority: 7
    container:
        image("core")
    threads: 1  # people are found meanwhile
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("depth.box"),
        code=code("depth.box"),
    shell:
        command("depth.box")


# The first picture of the scene, while people are still being found: nothing is made from it.
rule depth_preview:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/plates/{other}.png",
            other=files.training,
            allow_missing=True,
        ),
        sweeps=collect(
            "results/{scene}/depth/{other}.sweep.npz",
            other=files.training,
            allow_missing=True,
        ),
        box="results/{scene}/depth/box.json",
    output:
        film="results/{scene}/depth/preview.mp4",
    log:
        "logs/{scene}/depth/preview.log",
    benchmark:
        "timings/{scene}/depth/preview.tsv"
    priority: 7
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("depth.preview"),
        code=code("depth.preview"),
    shell:
        command("depth.preview")


rule depth_room:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/plates/{other}.png",
            other=files.training,
            allow_missing=True,
        ),
        sweeps=collect(
            "results/{scene}/depth/{other}.sweep.npz",
            other=files.training,
            allow_missing=True,
        ),
        box="results/{scene}/depth/box.json",
        fits=files.people_in_room,
        kernels="results/{scene}/depth/kernels.txt",
    output:
        room_box="results/{scene}/depth/room.json",
        primitives="results/{scene}/depth/primitives.json",
        picture="results/{scene}/depth/primitives.png",
    log:
        "logs/{scene}/depth/room.log",
    benchmark:
        "timings/{scene}/depth/room.tsv"
    # Everything that is drawn waits for it; bodies, which are fitted meanwhile, take less long.
    priority: 5
    container:
        image("core")
    threads: threads_beside(2)  # people are found meanwhile
    resources:
        mem_mb=memory(2500),
    params:
        settings=settings("depth.room"),
        code=code("depth.room"),
    shell:
        command("depth.room")


rule depth_refine:
    input:
        model=MODEL,
        plates=collect(
            "results/{scene}/plates/{other}.png",
            other=files.training,
            allow_missing=True,
        ),
        room_box="results/{scene}/depth/room.json",
        primitives="results/{scene}/depth/primitives.json",
        estimates=files.estimated_depth,
    output:
        depth="results/{scene}/depth/{camera}.exr",
    log:
        "logs/{scene}/depth/refine/{camera}.log",
    benchmark:
        "timings/{scene}/depth/refine/{camera}.tsv"
    # The survey waits for it, and everything after that; pages of people, made meanwhile, do not.
    priority: 5
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("depth.refine"),
        code=code("depth.refine"),
    shell:
        command("depth.refine")


rule depth_given:
    input:
        model=MODEL,
        source=files.given_depth,
    output:
        depth="results/{scene}/depth/{camera}.exr",
    log:
        "logs/{scene}/depth/given/{camera}.log",
    benchmark:
        "timings/{scene}/depth/given/{camera}.tsv"
    wildcard_constraints:
        camera=camera_pattern(PLAN.dataset.depth),
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        settings=settings("depth.given"),
        code=code("depth.given"),
    shell:
        command("depth.given")


if PLAN.networks.first_depth:

    # The paper's own: what the network that found the cameras says of the first moment.
    rule depth_first:
        input:
            model=MODEL,
            first="results/{scene}/calibration/network/{camera}.exr",
            found="results/{scene}/calibration/network/images.txt",
        output:
            depth="results/{scene}/depth/{camera}.exr",
        log:
            "logs/{scene}/depth/first/{camera}.log",
        benchmark:
            "timings/{scene}/depth/first/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(1000),
        params:
            code=code("depth.first"),
        shell:
            command("depth.first")


if PLAN.networks.depth not in ("", "precomputed") and not PLAN.networks.first_depth:

    rule depth_network:
        input:
            model=MODEL,
            plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
            network=files.depth_network,
        output:
            # Whoever is left out when cameras are found is known only then: of those the estimate is empty.
            depths=collect("results/{scene}/depth/{camera}.estimate.exr", camera=PLAN.training, allow_missing=True),
        log:
            "logs/{scene}/depth/network.log",
        benchmark:
            "timings/{scene}/depth/network.tsv"
        container:
            model_image(PLAN.networks.depth)
        threads: 1
        resources:
            mem_mb=memory(16000 if gpus(PLAN.networks.depth) else 4000),
            gpu=gpus(PLAN.networks.depth),
        params:
            settings=settings("depth.network"),
            code=code("depth.network"),
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("depth.network")
