rule capture_frames:
    input:
        source=files.footage,
        calibration="results/{scene}/calibration/calibration.json",
        clocks="results/{scene}/clocks/clocks.json",
    output:
        video="results/{scene}/capture/{camera}.mkv",
        footage="results/{scene}/capture/{camera}.json",
    log:
        "logs/{scene}/capture/frames/{camera}.log",
    benchmark:
        "timings/{scene}/capture/frames/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        settings=settings("capture.frames"),
        code=code("capture.frames"),
        held_out=lookup("{camera}", within={c: int(c in PLAN.held_out) for c in PLAN.cameras}),
        frame_count=PLAN.dataset.frame_count,
    shell:
        command("capture.frames")


rule capture_manifest:
    input:
        footage=collect("results/{scene}/capture/{camera}.json", camera=files.cameras, allow_missing=True),
    output:
        manifest="results/{scene}/capture/manifest.json",
    log:
        "logs/{scene}/capture/manifest.log",
    benchmark:
        "timings/{scene}/capture/manifest.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        code=code("capture.manifest"),
    shell:
        command("capture.manifest")
