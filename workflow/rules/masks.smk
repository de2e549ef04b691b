rule masks_segment:
    input:
        model=MODEL,
        video="results/{scene}/capture/{camera}.mkv",
        plate="results/{scene}/capture/{camera}.plate.png",
        footage="results/{scene}/capture/{camera}.json",
        calibration="results/{scene}/cameras/calibration.json",
        people=fits,
        body=BODY,
        given=given_masks,
        tracks=tracked_masks,
        objects=loose_objects,
        light=lights_course,
        seen=seen_people,
    output:
        masks="results/{scene}/masks/{camera}.mkv",
    log:
        "logs/{scene}/masks/segment/{camera}.log",
    benchmark:
        "benchmarks/{scene}/masks/segment/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("masks.segment"),
        code=code("masks.segment"),
    shell:
        "python -m studiorecon masks.segment --settings {params.settings:q} --log {log:q}"
        " --camera {wildcards.camera:q} --model {input.model[0]:q} --video {input.video:q} --plate {input.plate:q}"
        " --footage {input.footage:q} --calibration {input.calibration:q} --people {input.people:q} --body {input.body:q}"
        " --given {input.given:q} --tracks {input.tracks:q} --objects {input.objects:q} --light {input.light:q} --seen {input.seen:q}"
        " --masks {output.masks:q}"


if MASK_NETWORK:

    rule masks_network:
        input:
            video="results/{scene}/capture/{camera}.mkv",
            footage="results/{scene}/capture/{camera}.json",
        output:
            tracks="results/{scene}/masks/{camera}.tracks.mkv",
        log:
            "logs/{scene}/masks/network/{camera}.log",
        benchmark:
            "benchmarks/{scene}/masks/network/{camera}.tsv"
        container:
            model_image(MASK_NETWORK)
        threads: 2
        resources:
            mem_mb=16000,
            gpu=gpus(MASK_NETWORK),
        params:
            settings=settings("masks.network"),
            code=code("masks.network"),
            weights=WEIGHTS,
            device=config["device"],
        shell:
            "python -m studiorecon masks.network --settings {params.settings:q} --log {log:q}"
            " --camera {wildcards.camera:q} --video {input.video:q} --footage {input.footage:q} --weights {params.weights:q}"
            " --device {params.device} --tracks {output.tracks:q}"
