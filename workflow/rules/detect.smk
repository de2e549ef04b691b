# Detect: people in the footage as it was filmed, before any calibration: by the detector, or as recorded keypoints say.


if PLAN.dataset.chapters:

    rule detect_chapters:
        input:
            films=files.chapters,
        output:
            joined="results/{scene}/detect/chapters/{camera}.ffconcat",
        log:
            "logs/{scene}/detect/chapters/{camera}.log",
        benchmark:
            "timings/{scene}/detect/chapters/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(500),
        params:
            code=code("detect.chapters"),
        shell:
            command("detect.chapters")


if PLAN.person_sources.scale_cameras or not PLAN.person_sources.body_network:

    rule detect_people:
        input:
            source=files.footage,
            known=files.first_search,
            clocks=branch(PLAN.person_sources.uses_part, then="results/{scene}/clocks/clocks.json"),
            networks=files.detector,
            second=files.second_network,
        output:
            found="results/{scene}/detect/found/{camera}.npz",
        log:
            "logs/{scene}/detect/people/{camera}.log",
        benchmark:
            "timings/{scene}/detect/people/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(2000),
        params:
            code=code("detect.people"),
            layout=config["detect"]["network_layout"],
            picture_fps=config["capture"]["picture_fps"],
        shell:
            command("detect.people")


rule detect_keypoints:
    input:
        keypoints=files.keypoints,
        others=files.other_keypoints,
        source=files.footage,
    output:
        sightings="results/{scene}/detect/keypoints/{camera}.npz",
        recorded="results/{scene}/detect/recorded/{camera}.npz",
        size="results/{scene}/detect/keypoints/{camera}.json",
    log:
        "logs/{scene}/detect/keypoints/{camera}.log",
    benchmark:
        "timings/{scene}/detect/keypoints/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        settings=settings("detect.keypoints"),
        code=code("detect.keypoints"),
        layout=PLAN.dataset.keypoint_layout,
        other_cameras=lambda wildcards: files.keypoints_of_other_cameras(wildcards.camera),
        first_frame=lookup(
            "{camera}", within={c: str(PLAN.dataset.keypoint_first_frame.get(c, "auto")) for c in PLAN.cameras}
        ),
        picture_fps=config["capture"]["picture_fps"],
        pixel_map=lookup("{camera}", within={c: json.dumps(PLAN.dataset.pixel_maps.get(c, [])) for c in PLAN.cameras}),
    shell:
        command("detect.keypoints")
