# Cameras: the user's calibration in our convention, checked and refined on the people, as COLMAP models.


if FROM_PEOPLE:

    rule cameras_uncalibrated:
        input:
            sightings=collect("results/{scene}/people/sightings/{camera}.npz", camera=CAMERAS, allow_missing=True),
            sizes=collect("results/{scene}/people/sightings/{camera}.json", camera=CAMERAS, allow_missing=True),
            clocks="results/{scene}/capture/clocks.json",
            body=BODY,
        output:
            calibration="results/{scene}/cameras/calibration.json",
        log:
            "logs/{scene}/cameras/uncalibrated.log",
        benchmark:
            "benchmarks/{scene}/cameras/uncalibrated.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=1000,
        params:
            settings=settings("cameras.uncalibrated"),
            code=code("cameras.uncalibrated"),
            focal_px=json.dumps(dict(DATASET.focal_px)),
        shell:
            "python -m studiorecon cameras.uncalibrated --settings {params.settings:q} --log {log}"
            " --sightings {input.sightings:q} --sizes {input.sizes:q} --clocks {input.clocks:q} --body {input.body:q}"
            " --focal-px {params.focal_px:q} --calibration {output.calibration:q}"

else:

    rule cameras_calibration:
        input:
            files=CALIBRATION,
        output:
            calibration="results/{scene}/cameras/calibration.json",
        log:
            "logs/{scene}/cameras/calibration.log",
        benchmark:
            "benchmarks/{scene}/cameras/calibration.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=500,
        params:
            settings=settings("cameras.calibration"),
            code=code("cameras.calibration"),
            cameras=CAMERAS,
            pixel_maps=json.dumps(dict(DATASET.pixel_maps)),
        shell:
            "python -m studiorecon cameras.calibration --settings {params.settings:q} --log {log}"
            " --files {input.files:q} --cameras {params.cameras:q} --pixel-maps {params.pixel_maps:q} --calibration {output.calibration:q}"


if CAMERA_NETWORK:

    rule cameras_network:
        input:
            sources=[in_dataset(DATASET.footage[c]) for c in CAMERAS],
            sightings=collect(
                "results/{scene}/people/sightings/{camera}.npz",
                camera=CAMERAS if set(CAMERAS) <= set(WATCHED) else [],
                allow_missing=True,
            ),
            clocks="results/{scene}/capture/clocks.json",
            body=BODY,
        output:
            model="results/{scene}/cameras/network/images.txt",
            intrinsics="results/{scene}/cameras/network/cameras.txt",
            points="results/{scene}/cameras/network/points3D.txt",
        log:
            "logs/{scene}/cameras/network.log",
        benchmark:
            "benchmarks/{scene}/cameras/network.tsv"
        container:
            model_image(CAMERA_NETWORK)
        threads: 1
        resources:
            mem_mb=16000,
            gpu=gpus(CAMERA_NETWORK),
        params:
            settings=settings("cameras.network"),
            code=code("cameras.network"),
            cameras=CAMERAS,
            weights=WEIGHTS,
            device=config["device"],
        shell:
            "python -m studiorecon cameras.network --settings {params.settings:q} --log {log}"
            " --cameras {params.cameras:q} --sources {input.sources:q} --clocks {input.clocks:q} --sightings {input.sightings:q}"
            " --body {input.body:q} --weights {params.weights:q} --device {params.device} --model {output.model:q}"


rule cameras_refine:
    input:
        calibration="results/{scene}/cameras/calibration.json",
        manifest="results/{scene}/capture/manifest.json",
        detections=first_detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
    output:
        model="results/{scene}/cameras/images.txt",
        intrinsics="results/{scene}/cameras/cameras.txt",
        points="results/{scene}/cameras/points3D.txt",
        heldout_model="results/{scene}/cameras/heldout/images.txt",
        heldout_intrinsics="results/{scene}/cameras/heldout/cameras.txt",
        refinement="results/{scene}/cameras/refinement.json",
        sheet="results/{scene}/cameras/refinement.png",
    log:
        "logs/{scene}/cameras/refine.log",
    benchmark:
        "benchmarks/{scene}/cameras/refine.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("cameras.refine"),
        code=code("cameras.refine"),
    shell:
        "python -m studiorecon cameras.refine --settings {params.settings:q} --log {log}"
        " --calibration {input.calibration:q} --manifest {input.manifest:q} --detections {input.detections:q} --videos {input.videos:q}"
        " --model {output.model:q} --heldout-model {output.heldout_model:q} --refinement {output.refinement:q} --sheet {output.sheet:q}"
