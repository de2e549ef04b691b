# Tracks: keypoints of every camera in undistorted working pixels, followed through time: what each camera says by itself.


if PLAN.person_sources.body_network:

    rule tracks_bodies:
        input:
            video="results/{scene}/capture/{camera}.mkv",
            footage="results/{scene}/capture/{camera}.json",
            clocks="results/{scene}/clocks/clocks.json",
            given=files.given_bodies,
        output:
            detections="results/{scene}/tracks/{camera}.npz",
        log:
            "logs/{scene}/tracks/bodies/{camera}.log",
        benchmark:
            "timings/{scene}/tracks/bodies/{camera}.tsv"
        container:
            model_image(PLAN.person_sources.body_network)
        threads: 2
        resources:
            mem_mb=memory(8000),
            gpu=gpus(PLAN.person_sources.body_network),
        params:
            settings=settings("tracks.bodies"),
            code=code("tracks.bodies"),
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("tracks.bodies")

else:

    rule tracks_keypoints:
        input:
            keypoints=files.read_keypoints,
            clocks="results/{scene}/clocks/clocks.json",
            footage="results/{scene}/capture/{camera}.json",
            calibration="results/{scene}/calibration/calibration.json",
        output:
            detections="results/{scene}/tracks/{camera}.npz",
        log:
            "logs/{scene}/tracks/keypoints/{camera}.log",
        benchmark:
            "timings/{scene}/tracks/keypoints/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(500),
        params:
            settings=settings("tracks.keypoints"),
            code=code("tracks.keypoints"),
        shell:
            command("tracks.keypoints")
