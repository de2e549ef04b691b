# Cameras: the calibration, checked and refined on the people in it, as COLMAP models.


rule cameras_refine:
    input:
        calibration="results/{scene}/calibration/calibration.json",
        manifest="results/{scene}/capture/manifest.json",
        detections=files.first_detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
    output:
        model="results/{scene}/cameras/images.txt",
        intrinsics="results/{scene}/cameras/cameras.txt",
        points="results/{scene}/cameras/points3D.txt",
        heldout_model="results/{scene}/cameras/heldout/given/images.txt",
        heldout_intrinsics="results/{scene}/cameras/heldout/given/cameras.txt",
        refinement="results/{scene}/cameras/refinement.json",
        sheet="results/{scene}/cameras/refinement.png",
    log:
        "logs/{scene}/cameras/refine.log",
    benchmark:
        "timings/{scene}/cameras/refine.tsv"
    # Everything later waits for it: before kernels are compiled, which is done beside it.
    priority: 5
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        settings=settings("cameras.refine"),
        code=code("cameras.refine"),
    shell:
        command("cameras.refine")


# Held-out pictures say where the camera stood that took them, and nothing else.
rule cameras_held_out:
    input:
        manifest="results/{scene}/capture/manifest.json",
        clocks="results/{scene}/clocks/clocks.json",
        model=MODEL,
        given_model=[f"results/{{scene}}/cameras/heldout/given/{name}.txt" for name in ("images", "cameras")],
        detections=files.first_detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.held_out, allow_missing=True),
        networks=files.detector,
        second=files.second_network,
    output:
        heldout_model="results/{scene}/cameras/heldout/images.txt",
        heldout_intrinsics="results/{scene}/cameras/heldout/cameras.txt",
        poses="results/{scene}/cameras/heldout/poses.json",
    log:
        "logs/{scene}/cameras/held_out.log",
    benchmark:
        "timings/{scene}/cameras/held_out.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        settings=settings("cameras.held_out"),
        code=code("cameras.held_out"),
        layout=config["detect"]["network_layout"],
    shell:
        command("cameras.held_out")
