# Films that do not flicker: every picture through the enhancer, earlier outputs injected, where the scene calls for it.


rule enhance_shot:
    input:
        render="results/{scene}/render/{shot}.mkv",
        render_path="results/{scene}/render/{shot}.json",
        render_depth="results/{scene}/render/{shot}.depth.mkv",
        # Film, path and depth of the training cameras, which tell what their photos show beyond it.
        train=files.training_renders,
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        truth=files.replacement_truth,
        edited=files.edited_reference,
        made=files.external_film,
        exposure=files.exposure,
    output:
        video="results/{scene}/enhance/{shot}.mkv",
        film="results/{scene}/enhance/{shot}.mp4",
        decisions="results/{scene}/enhance/{shot}.decisions.json",
    log:
        "logs/{scene}/enhance/shot/{shot}.log",
    benchmark:
        "timings/{scene}/enhance/shot/{shot}.tsv"
    # Before the next film is drawn.
    priority: 12
    container:
        model_image(PLAN.networks.enhance)
    threads: threads_beside(len(PLAN.shots))
    resources:
        mem_mb=memory(16000 if PLAN.networks.enhance else 1500),
        gpu=gpus(PLAN.networks.enhance),
    params:
        settings=settings("enhance.shot"),
        code=code("enhance.shot"),
        weights=PLAN.networks.weights if PLAN.networks.enhance else "none",
        device=config["device"] if PLAN.networks.enhance else "cpu",
    message:
        "Enhance film {wildcards.shot} where the scene needs it: {output.film}"
    shell:
        command("enhance.shot")
