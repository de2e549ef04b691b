# People: 2D keypoints of every camera, who is who (the checkpoint), and one body per person over time.


rule people_detections:
    input:
        keypoints=keypoint_source,
        footage="results/{scene}/capture/{camera}.json",
        calibration="results/{scene}/cameras/calibration.json",
    output:
        detections="results/{scene}/people/detections/{camera}.npz",
    log:
        "logs/{scene}/people/detections/{camera}.log",
    benchmark:
        "benchmarks/{scene}/people/detections/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        settings=settings("people"),
        code=code("people.detections"),
        layout=DATASET.keypoint_layout,
    shell:
        "python -m studiorecon people.detections --settings {params.settings:q} --log {log}"
        " --camera {wildcards.camera} --keypoints {input.keypoints:q} --layout {params.layout} --footage {input.footage:q}"
        " --calibration {input.calibration:q} --detections {output.detections:q}"


checkpoint people_associate:
    input:
        model="results/{scene}/cameras/images.txt",
        manifest="results/{scene}/capture/manifest.json",
        detections=collect(
            "results/{scene}/people/detections/{camera}.npz",
            camera=TRAINING,
            allow_missing=True,
        ),
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
    output:
        people="results/{scene}/people/people.tsv",
        identities="results/{scene}/people/identities.tsv",
    log:
        "logs/{scene}/people/associate.log",
    benchmark:
        "benchmarks/{scene}/people/associate.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("people"),
        code=code("people.associate"),
    shell:
        "python -m studiorecon people.associate --settings {params.settings:q} --log {log}"
        " --model {input.model:q} --manifest {input.manifest:q} --detections {input.detections:q} --videos {input.videos:q}"
        " --people {output.people:q} --identities {output.identities:q}"


rule people_fit:
    input:
        model="results/{scene}/cameras/images.txt",
        manifest="results/{scene}/capture/manifest.json",
        detections=collect(
            "results/{scene}/people/detections/{camera}.npz",
            camera=TRAINING,
            allow_missing=True,
        ),
        identities="results/{scene}/people/identities.tsv",
        body=BODY,
    output:
        fit="results/{scene}/people/{person}.npz",
    log:
        "logs/{scene}/people/fit/{person}.log",
    benchmark:
        "benchmarks/{scene}/people/fit/{person}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("people"),
        code=code("people.fit"),
    shell:
        "python -m studiorecon people.fit --settings {params.settings:q} --log {log}"
        " --person {wildcards.person} --model {input.model:q} --manifest {input.manifest:q} --detections {input.detections:q}"
        " --identities {input.identities:q} --body {input.body:q} --fit {output.fit:q}"
