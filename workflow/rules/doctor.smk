# Doctor: before anything expensive, does the calibration fit the people? snakemake doctor --config dataset=DIR
# Reads keypoints (the detector's are found once and serve the whole run), headers and three pictures per camera.


rule people_sightings:
    input:
        keypoints=keypoint_source,
        source=footage_source,
    output:
        sightings="results/{scene}/people/sightings/{camera}.npz",
        size="results/{scene}/people/sightings/{camera}.json",
    log:
        "logs/{scene}/people/sightings/{camera}.log",
    benchmark:
        "benchmarks/{scene}/people/sightings/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        settings=settings("people.sightings"),
        code=code("people.sightings"),
        layout=DATASET.keypoint_layout,
        first_frame=DATASET.keypoint_first_frame,
        picture_fps=config["capture"]["picture_fps"],
        pixel_map=lookup("{camera}", within={c: json.dumps(DATASET.pixel_maps.get(c, [])) for c in CAMERAS}),
    shell:
        "python -m studiorecon people.sightings --settings {params.settings:q} --log {log:q}"
        " --camera {wildcards.camera:q} --keypoints {input.keypoints:q} --layout {params.layout} --first-frame {params.first_frame}"
        " --source {input.source:q} --picture-fps {params.picture_fps} --pixel-map {params.pixel_map:q}"
        " --sightings {output.sightings:q} --size {output.size:q}"


rule cameras_doctor:
    input:
        calibration="results/{scene}/cameras/calibration.json",
        sources=[in_dataset(DATASET.footage[c]) for c in CAMERAS],
        sightings=collect("results/{scene}/people/sightings/{camera}.npz", camera=CHECKED, allow_missing=True),
        sizes=collect("results/{scene}/people/sightings/{camera}.json", camera=CHECKED, allow_missing=True),
        clocks="results/{scene}/capture/clocks.json",
        sync="results/{scene}/capture/sync.json",
    output:
        report="results/{scene}/cameras/doctor.json",
        doctor="results/{scene}/cameras/doctor.html",
    log:
        "logs/{scene}/cameras/doctor.log",
    benchmark:
        "benchmarks/{scene}/cameras/doctor.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("cameras.doctor"),
        code=code("cameras.doctor"),
        cameras=CAMERAS,
    shell:
        "python -m studiorecon cameras.doctor --settings {params.settings:q} --log {log}"
        " --scene {wildcards.scene:q} --calibration {input.calibration:q} --cameras {params.cameras:q} --sources {input.sources:q}"
        " --sightings {input.sightings:q} --sizes {input.sizes:q} --clocks {input.clocks:q} --sync {input.sync:q}"
        " --report {output.report:q} --doctor {output.doctor:q}"


rule doctor:
    input:
        f"results/{SCENE}/cameras/doctor.html",
    localrule: True
