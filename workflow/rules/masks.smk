rule masks_segment:
    input:
        model=MODEL,
        video="results/{scene}/capture/{camera}.mkv",
        plate="results/{scene}/plates/{camera}.png",
        footage="results/{scene}/capture/{camera}.json",
        calibration="results/{scene}/calibration/calibration.json",
        fits=files.fits,
        body=files.body,
        given=files.given_masks,
        tracks=files.tracked_masks,
        objects=files.loose_objects,
        brightness=files.brightness,
        seen=files.detector_masks,
    output:
        masks="results/{scene}/masks/{camera}.mkv",
    log:
        "logs/{scene}/masks/segment/{camera}.log",
    benchmark:
        "timings/{scene}/masks/segment/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("masks.segment"),
        code=code("masks.segment"),
    shell:
        command("masks.segment")


if PLAN.networks.masks:

    rule masks_network:
        input:
            video="results/{scene}/capture/{camera}.mkv",
            footage="results/{scene}/capture/{camera}.json",
        output:
            tracks="results/{scene}/masks/{camera}.tracks.mkv",
        log:
            "logs/{scene}/masks/network/{camera}.log",
        benchmark:
            "timings/{scene}/masks/network/{camera}.tsv"
        container:
            model_image(PLAN.networks.masks)
        threads: 2
        resources:
            mem_mb=memory(16000),
            gpu=gpus(PLAN.networks.masks),
        params:
            settings=settings("masks.network"),
            code=code("masks.network"),
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("masks.network")
