# The made studio: only when the dataset is a description, which is then filmed first.

if STUDIO:

    rule studio_capture:
        input:
            description=DESCRIPTION,
            defaults=local(str(Path(workflow.basedir) / "resources/studio/defaults.yaml")),
            body=local(str(Path(workflow.basedir) / "resources/body.npz")),
        output:
            videos=[str(f) for f in DATASET.footage.values()],
            calibration=[str(f) for f in DATASET.calibration],
            keypoints=[directory(str(f)) for f in DATASET.keypoints.values()],
            plates=[str(f) for f in DATASET.plates.values()],
            capture=f"results/studio/{STUDIO}/dataset/capture.yaml",
            truth=directory(f"results/studio/{STUDIO}/truth"),
        log:
            f"logs/studio/{STUDIO}/capture.log",
        benchmark:
            f"benchmarks/studio/{STUDIO}/capture.tsv"
        container:
            image("core")
        threads: 2
        resources:
            mem_mb=2500,
        params:
            dataset=subpath(output.capture, parent=True),
            code=code("studio.capture"),
        shell:
            "python -m studiorecon studio.capture --log {log}"
            " --description {input.description:q} --body {input.body:q} --processes {threads}"
            " --dataset {params.dataset} --truth {output.truth}"
