rule capture_clocks:
    input:
        sources=[in_dataset(DATASET.footage[c]) for c in CAMERAS],
        sightings=collect("results/{scene}/people/sightings/{camera}.npz", camera=TIMED, allow_missing=True),
    output:
        clocks="results/{scene}/capture/clocks.json",
        findings="results/{scene}/capture/sync.json",
    log:
        "logs/{scene}/capture/clocks.log",
    benchmark:
        "benchmarks/{scene}/capture/clocks.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("capture.clocks"),
        code=code("capture.clocks"),
        cameras=CAMERAS,
        starts=json.dumps(dict(DATASET.starts)),
        first_frame=DATASET.first_frame,
        frame_count=DATASET.frame_count,
    shell:
        "python -m studiorecon capture.clocks --settings {params.settings:q} --log {log:q}"
        " --cameras {params.cameras:q} --sources {input.sources:q} --sightings {input.sightings:q} --starts {params.starts:q}"
        " --first {params.first_frame} --count {params.frame_count} --clocks {output.clocks:q} --findings {output.findings:q}"


rule capture_frames:
    input:
        source=footage_source,
        calibration="results/{scene}/cameras/calibration.json",
        clocks="results/{scene}/capture/clocks.json",
    output:
        video="results/{scene}/capture/{camera}.mkv",
        footage="results/{scene}/capture/{camera}.json",
    log:
        "logs/{scene}/capture/frames/{camera}.log",
    benchmark:
        "benchmarks/{scene}/capture/frames/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("capture.frames"),
        code=code("capture.frames"),
        held_out=lookup("{camera}", within={c: int(c in HELDOUT) for c in CAMERAS}),
        frame_count=DATASET.frame_count,
    shell:
        "python -m studiorecon capture.frames --settings {params.settings:q} --log {log:q}"
        " --camera {wildcards.camera:q} --held-out {params.held_out} --count {params.frame_count}"
        " --source {input.source:q} --calibration {input.calibration:q} --clocks {input.clocks:q}"
        " --video {output.video:q} --footage {output.footage:q}"


rule capture_manifest:
    input:
        footage=collect("results/{scene}/capture/{camera}.json", camera=CAMERAS, allow_missing=True),
    output:
        manifest="results/{scene}/capture/manifest.json",
    log:
        "logs/{scene}/capture/manifest.log",
    benchmark:
        "benchmarks/{scene}/capture/manifest.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        code=code("capture.manifest"),
    shell:
        "python -m studiorecon capture.manifest --log {log:q}"
        " --scene {wildcards.scene:q} --footage {input.footage:q} --manifest {output.manifest:q}"


rule capture_plate:
    input:
        video="results/{scene}/capture/{camera}.mkv",
        footage="results/{scene}/capture/{camera}.json",
        calibration="results/{scene}/cameras/calibration.json",
        detections=first_detection,
        given=given_plate,
    output:
        plate="results/{scene}/capture/{camera}.plate.png",
    log:
        "logs/{scene}/capture/plate/{camera}.log",
    benchmark:
        "benchmarks/{scene}/capture/plate/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("capture.plate"),
        code=code("capture.plate"),
    shell:
        "python -m studiorecon capture.plate --settings {params.settings:q} --log {log:q}"
        " --video {input.video:q} --footage {input.footage:q} --calibration {input.calibration:q}"
        " --detections {input.detections:q} --given {input.given:q} --plate {output.plate:q}"
