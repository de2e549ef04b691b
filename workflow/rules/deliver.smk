# The result in formats that other tools read.


rule deliver_export:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=[*MODEL, "results/{scene}/cameras/points3D.txt"],
        background="results/{scene}/background/scene.ply",
        gaussians=human_gaussians,
        avatars=human_avatars,
        fits=fits,
        body=BODY,
        detections=detections,
        identities=branch(DATASET.people, then="results/{scene}/people/identities.tsv"),
        films=collect("results/{scene}/enhance/{shot}.mp4", shot=FILMS, allow_missing=True),
    output:
        contents="results/{scene}/deliver/manifest.json",
    log:
        "logs/{scene}/deliver/export.log",
    benchmark:
        "benchmarks/{scene}/deliver/export.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("deliver.export"),
        code=code("deliver.export"),
    shell:
        "python -m studiorecon deliver.export --settings {params.settings:q} --log {log}"
        " --scene {wildcards.scene} --manifest {input.manifest} --model {input.model[0]:q} --background {input.background}"
        " --gaussians {input.gaussians:q} --avatars {input.avatars:q} --fits {input.fits:q} --body {input.body}"
        " --films {input.films:q} --detections {input.detections:q} --identities {input.identities:q} --contents {output.contents}"
