# Clocks: when every camera was started, and which frame of each shows which moment.


rule clocks_moments:
    input:
        sources=files.all_footage,
        networks=files.detector if PLAN.first_searched else [],
        second=files.second_network if PLAN.first_searched else [],
    output:
        lags="results/{scene}/clocks/lags.json",
        found=collect("results/{scene}/clocks/people/{camera}.npz", camera=PLAN.first_searched, allow_missing=True),
    log:
        "logs/{scene}/clocks/moments.log",
    benchmark:
        "timings/{scene}/clocks/moments.tsv"
    container:
        image("core")
    threads: len(PLAN.cameras)
    resources:
        mem_mb=memory(1000 + 500 * len(PLAN.first_searched)),
    params:
        settings=settings("clocks.moments"),
        code=code("clocks.moments"),
        layout=config["detect"]["network_layout"],
        cameras=PLAN.cameras,
        searched=PLAN.first_searched,
        starts=json.dumps(dict(PLAN.dataset.starts)),
        first_frame=PLAN.dataset.first_frame,
        frame_count=PLAN.dataset.frame_count,
        # Cameras without a calibration are made from all that people do.
        whole=int(PLAN.from_people),
    shell:
        command("clocks.moments")


rule clocks_offsets:
    input:
        sources=files.all_footage,
        sightings=collect(
            "results/{scene}/detect/keypoints/{camera}.npz",
            camera=PLAN.person_sources.clock_cameras,
            allow_missing=True,
        ),
        lags="results/{scene}/clocks/lags.json",
        # The user's own files alone: cameras found from people hang on clocks.
        calibration=branch(PLAN.calibrated, then="results/{scene}/calibration/calibration.json"),
    output:
        clocks="results/{scene}/clocks/clocks.json",
        findings="results/{scene}/clocks/sync.json",
    log:
        "logs/{scene}/clocks/offsets.log",
    benchmark:
        "timings/{scene}/clocks/offsets.tsv"
    container:
        image("core")
    threads: len(PLAN.cameras)
    resources:
        mem_mb=memory(1000),
    params:
        settings=settings("clocks.offsets"),
        code=code("clocks.offsets"),
        cameras=PLAN.cameras,
        starts=json.dumps(dict(PLAN.dataset.starts)),
        first_frame=PLAN.dataset.first_frame,
        frame_count=PLAN.dataset.frame_count,
    shell:
        command("clocks.offsets")
