# New views between the cameras: the path, then one job per gap between neighbours, by warping or by GEN3C (views.synthesizer).


rule views_path:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
    output:
        path="results/{scene}/views/path.json",
    log:
        "logs/{scene}/views/path.log",
    benchmark:
        "timings/{scene}/views/path.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        settings=settings("views.path"),
        code=code("views.path"),
    shell:
        command("views.path")


if PLAN.networks.views == "warp":

    rule views_synthesize:
        input:
            path="results/{scene}/views/path.json",
            model=MODEL,
            plates=collect(
                "results/{scene}/plates/{camera}.png",
                camera=files.training,
                allow_missing=True,
            ),
            depths=collect("results/{scene}/depth/{camera}.exr", camera=files.training, allow_missing=True),
            gains=files.gains,
        output:
            views="results/{scene}/views/{segment}.mkv",
            support="results/{scene}/views/{segment}.mask.mkv",
        log:
            "logs/{scene}/views/{segment}.log",
        benchmark:
            "timings/{scene}/views/{segment}.tsv"
        # The room waits for all of them and is trained longest: before masks, which people wait for.
        priority: 5
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(1500),
        params:
            settings=settings("views.synthesize"),
            code=code("views.synthesize"),
        shell:
            command("views.synthesize")


if PLAN.networks.views not in ("warp", "precomputed"):

    rule views_request:
        input:
            path="results/{scene}/views/path.json",
            model=MODEL,
            plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
            depths=collect("results/{scene}/depth/{camera}.exr", camera=files.training, allow_missing=True),
            gains=files.gains,
            videos=files.key_frames,
            masks=files.key_masks,
            fits=files.key_people,
            body=files.key_body,
        output:
            request="results/{scene}/views/{segment}.request.npz",
        log:
            "logs/{scene}/views/request/{segment}.log",
        benchmark:
            "timings/{scene}/views/request/{segment}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(3000),
        params:
            settings=settings("views.request"),
            code=code("views.request"),
            reference=config["depth"]["reference"],
        shell:
            command("views.request")

    # One segment, one job, one GPU: on a cluster they run side by side, and a finished one stays.
    rule views_generate:
        input:
            requests="results/{scene}/views/{segment}.request.npz",
        output:
            films="results/{scene}/views/{segment}.film.mkv",
        log:
            "logs/{scene}/views/generate/{segment}.log",
        benchmark:
            "timings/{scene}/views/generate/{segment}.tsv"
        container:
            model_image(PLAN.networks.views)
        threads: 4
        resources:
            mem_mb=memory(64000),
            gpu=1,
        params:
            settings=settings("views.generate"),
            code=code("views.generate"),
            weights=PLAN.networks.weights,
        shell:
            command("views.generate")


if PLAN.networks.people_in_views:

    # The paper's M: a network looks for people in every synthesized view.
    rule views_people:
        input:
            film=files.generated_film,
        output:
            people="results/{scene}/views/{segment}.people.mkv",
        log:
            "logs/{scene}/views/people/{segment}.log",
        benchmark:
            "timings/{scene}/views/people/{segment}.tsv"
        container:
            model_image(PLAN.networks.people_in_views)
        threads: 2
        resources:
            mem_mb=memory(16000),
            gpu=gpus(PLAN.networks.people_in_views),
        params:
            code=code("views.people"),
            network=PLAN.networks.people_in_views,
            chunk=config["masks"]["sam3"]["chunk"],
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("views.people")


if PLAN.networks.views != "warp":

    rule views_fitted:
        input:
            film=files.generated_film,
            path="results/{scene}/views/path.json",
            model=MODEL,
            plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
            depths=collect("results/{scene}/depth/{camera}.exr", camera=files.training, allow_missing=True),
            gains=files.gains,
            fits=files.people_of_views,
            body=files.body,
            seen=files.people_in_views,
        output:
            views="results/{scene}/views/{segment}.mkv",
            support="results/{scene}/views/{segment}.mask.mkv",
        log:
            "logs/{scene}/views/{segment}.log",
        benchmark:
            "timings/{scene}/views/{segment}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(2000),
        params:
            settings=settings("views.fitted"),
            code=code("views.fitted"),
        shell:
            command("views.fitted")
