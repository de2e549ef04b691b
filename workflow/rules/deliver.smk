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


rule deliver_mesh:
    input:
        model=MODEL,
        background="results/{scene}/background/scene.ply",
        provenance="results/{scene}/background/provenance.npz",
        room="results/{scene}/depth/shell.json",
        path="results/{scene}/views/path.json",
    output:
        mesh="results/{scene}/deliver/room.glb",
    log:
        "logs/{scene}/deliver/mesh.log",
    benchmark:
        "benchmarks/{scene}/deliver/mesh.tsv"
    container:
        image("vision")
    threads: 2
    resources:
        mem_mb=4000,
    params:
        code=code("deliver.mesh"),
    shell:
        "python -m studiorecon deliver.mesh --log {log:q} --model {input.model[0]:q} --background {input.background:q}"
        " --provenance {input.provenance:q} --room {input.room:q} --path {input.path:q} --mesh {output.mesh:q}"


# On request: the extra mesh is 400 MB, and most never open a mesh.
rule room_mesh:
    input:
        f"results/{SCENE}/deliver/room.glb",
    localrule: True
