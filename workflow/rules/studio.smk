# The synthetic studio: only when the dataset is a description, which is then filmed first.

if PLAN.studio:

    rule studio_capture:
        input:
            description=local(PLAN.description),
            defaults=files.bundled("resources/studio/defaults.yaml"),
            body=files.bundled("resources/body.npz"),
        output:
            videos=[str(f) for f in PLAN.dataset.footage.values()],
            calibration=[str(f) for f in PLAN.dataset.calibration],
            keypoints=[directory(str(f)) for f in PLAN.dataset.keypoints.values()],
            plates=[str(f) for f in PLAN.dataset.plates.values()],
            capture=f"results/studio/{PLAN.studio}/dataset/capture.yaml",
            truth=directory(f"results/studio/{PLAN.studio}/truth"),
        log:
            f"logs/studio/{PLAN.studio}/capture.log",
        benchmark:
            f"timings/studio/{PLAN.studio}/capture.tsv"
        container:
            image("core")
        threads: 2
        resources:
            mem_mb=memory(2500),
        params:
            dataset=subpath(output.capture, parent=True),
            code=code("studio.capture"),
        shell:
            command("studio.capture")
