# Calibration: lenses and poses in the metric world, from files, from the people in the pictures, or from a network.
# Doctor: before anything expensive, does it fit the people? snakemake doctor --config dataset=DIR
# Reads keypoints (the detector's are found once and serve the whole run), headers and a dozen pictures per camera.


if PLAN.from_people:

    # A checkpoint: a camera that people do not place is left out of everything that follows.
    checkpoint calibration_from_people:
        input:
            sightings=collect("results/{scene}/detect/keypoints/{camera}.npz", camera=PLAN.cameras, allow_missing=True),
            sizes=collect("results/{scene}/detect/keypoints/{camera}.json", camera=PLAN.cameras, allow_missing=True),
            clocks="results/{scene}/clocks/clocks.json",
            body=files.body,
            sources=files.all_footage,
            lenses=files.lenses,
        output:
            calibration="results/{scene}/calibration/calibration.json",
        log:
            "logs/{scene}/calibration/from_people.log",
        benchmark:
            "timings/{scene}/calibration/from_people.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(1000),
        params:
            settings=settings("calibration.from_people"),
            code=code("calibration.from_people"),
            cameras=PLAN.cameras,
            training=PLAN.training,
            focal_px=json.dumps(dict(PLAN.dataset.focal_px)),
            lengths=json.dumps(dict(PLAN.dataset.lengths)),
        shell:
            command("calibration.from_people")

else:

    rule calibration_files:
        input:
            files=files.calibration,
        output:
            read="results/{scene}/calibration/read.json",
        log:
            "logs/{scene}/calibration/files.log",
        benchmark:
            "timings/{scene}/calibration/files.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(500),
        params:
            settings=settings("calibration.files"),
            code=code("calibration.files"),
            cameras=PLAN.cameras,
        shell:
            command("calibration.files")

    rule calibration_choose:
        input:
            read="results/{scene}/calibration/read.json",
            sources=files.all_footage,
            sightings=collect(
                "results/{scene}/detect/keypoints/{camera}.npz",
                camera=PLAN.person_sources.clock_cameras,
                allow_missing=True,
            ),
        output:
            calibration="results/{scene}/calibration/calibration.json",
        log:
            "logs/{scene}/calibration/choose.log",
        benchmark:
            "timings/{scene}/calibration/choose.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(500),
        params:
            settings=settings("calibration.choose"),
            code=code("calibration.choose"),
            cameras=PLAN.cameras,
            pixel_maps=json.dumps(dict(PLAN.dataset.pixel_maps)),
            picture_fps=config["capture"]["picture_fps"],
            recorded=PLAN.person_sources.file_cameras if config["detect"]["keypoint_pixels"] == "auto" else [],
        shell:
            command("calibration.choose")


if PLAN.networks.cameras:

    rule calibration_network:
        input:
            sources=files.all_footage,
            sightings=collect(
                "results/{scene}/detect/keypoints/{camera}.npz",
                camera=PLAN.training if set(PLAN.training) <= set(PLAN.person_sources.cameras) else [],
                allow_missing=True,
            ),
            clocks="results/{scene}/clocks/clocks.json",
            body=files.body,
        output:
            model="results/{scene}/calibration/network/images.txt",
            intrinsics="results/{scene}/calibration/network/cameras.txt",
            points="results/{scene}/calibration/network/points3D.txt",
            depths=collect("results/{scene}/calibration/network/{camera}.exr", camera=PLAN.cameras, allow_missing=True),
        log:
            "logs/{scene}/calibration/network.log",
        benchmark:
            "timings/{scene}/calibration/network.tsv"
        container:
            model_image(PLAN.networks.cameras)
        threads: 1
        resources:
            mem_mb=memory(16000),
            gpu=gpus(PLAN.networks.cameras),
        params:
            settings=settings("calibration.network"),
            code=code("calibration.network"),
            cameras=PLAN.cameras,
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("calibration.network")


rule calibration_doctor:
    input:
        calibration="results/{scene}/calibration/calibration.json",
        sources=files.all_footage,
        sightings=collect(
            "results/{scene}/detect/keypoints/{camera}.npz",
            camera=PLAN.person_sources.doctor_cameras,
            allow_missing=True,
        ),
        sizes=collect(
            "results/{scene}/detect/keypoints/{camera}.json",
            camera=PLAN.person_sources.doctor_cameras,
            allow_missing=True,
        ),
        clocks="results/{scene}/clocks/clocks.json",
        sync="results/{scene}/clocks/sync.json",
    output:
        report="results/{scene}/calibration/doctor.json",
        doctor="results/{scene}/calibration/doctor.html",
    log:
        "logs/{scene}/calibration/doctor.log",
    benchmark:
        "timings/{scene}/calibration/doctor.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("calibration.doctor"),
        code=code("calibration.doctor"),
        cameras=PLAN.cameras,
        notes=json.dumps(PLAN.dataset.notes),
    shell:
        command("calibration.doctor")


rule doctor:
    input:
        f"results/{PLAN.scene}/calibration/doctor.html",
    localrule: True
