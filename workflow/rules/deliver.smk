# The result in formats that other tools read.


rule deliver_export:
    input:
        **TRAINED,
        manifest="results/{scene}/capture/manifest.json",
        model=[*MODEL, "results/{scene}/cameras/points3D.txt"],
        fits=files.fits,
        detections=files.detections,
        identities=files.identities,
        films=collect("results/{scene}/enhance/{shot}.mp4", shot=files.films, allow_missing=True),
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        blender=files.bundled("resources/blender.py"),
    output:
        contents="results/{scene}/deliver/manifest.json",
    log:
        "logs/{scene}/deliver/export.log",
    benchmark:
        "timings/{scene}/deliver/export.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("deliver.export"),
        code=code("deliver.export"),
    shell:
        command("deliver.export")


# One page to move through the scene and its time, from disk and without a network.
rule deliver_player:
    input:
        **TRAINED,
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        paths=collect("results/{scene}/render/{shot}.json", shot=files.films, allow_missing=True),
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        exposure=files.exposure,
        shade=files.room_shade,
        parts=files.player,
    output:
        page="results/{scene}/deliver/player.html",
        poster="results/{scene}/deliver/player.jpg",
    log:
        "logs/{scene}/deliver/player.log",
    benchmark:
        "timings/{scene}/deliver/player.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(2000),
    params:
        code=code("deliver.player"),
    message:
        "Write the player: {output.page}"
    shell:
        command("deliver.player")


# The scene as one file for others' viewers: nothing but what Python already has is needed for it.
rule deliver_scene_glb:
    input:
        **TRAINED,
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
    output:
        glb="results/{scene}/deliver/scene.glb",
    log:
        "logs/{scene}/deliver/scene_glb.log",
    benchmark:
        "timings/{scene}/deliver/scene_glb.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        code=code("deliver.scene_glb"),
    message:
        "Write the scene as glTF: {output.glb}"
    shell:
        command("deliver.scene_glb")


rule deliver_mesh:
    input:
        model=MODEL,
        background="results/{scene}/background/scene.ply",
        provenance="results/{scene}/background/provenance.npz",
        room_box="results/{scene}/depth/room.json",
        path="results/{scene}/views/path.json",
    output:
        mesh="results/{scene}/deliver/room.glb",
    log:
        "logs/{scene}/deliver/mesh.log",
    benchmark:
        "timings/{scene}/deliver/mesh.tsv"
    container:
        image("vision")
    threads: 2
    resources:
        mem_mb=memory(4000),
    params:
        code=code("deliver.mesh"),
    shell:
        command("deliver.mesh")


# On request: the extra mesh is 400 MB, and most never open a mesh.
rule room_mesh:
    input:
        f"results/{PLAN.scene}/deliver/room.glb",
    localrule: True


rule deliver_usd:
    input:
        **TRAINED,
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
    output:
        stage="results/{scene}/deliver/scene.usdc",
    log:
        "logs/{scene}/deliver/usd.log",
    benchmark:
        "timings/{scene}/deliver/usd.tsv"
    container:
        image("vision")
    threads: 1
    resources:
        mem_mb=memory(2000),
    params:
        code=code("deliver.usd"),
    message:
        "Write the scene as OpenUSD: {output.stage}"
    shell:
        command("deliver.usd")


# On request: the extra usd takes 210 MB, and most never open a stage.
rule scene_usd:
    input:
        f"results/{PLAN.scene}/deliver/scene.usdc",
    localrule: True
