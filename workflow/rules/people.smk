# People: 2D keypoints of every camera, who is who (the checkpoint), and one body per person over time.


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
        body="resources/body.npz",
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
