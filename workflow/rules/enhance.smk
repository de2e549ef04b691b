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
        made=files.made_films,
        decided_before=files.segment_decisions,
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
        # A film that is put together of its segments needs none.
        gpu=lambda wildcards, input: 0 if input.decided_before else gpus(PLAN.networks.enhance),
    params:
        settings=settings("enhance.shot"),
        code=code("enhance.shot"),
        weights=PLAN.networks.weights if PLAN.networks.enhance else "none",
        device=config["device"] if PLAN.networks.enhance else "cpu",
        only=[],
    message:
        "Enhance film {wildcards.shot} where the scene needs it: {output.film}"
    shell:
        command("enhance.shot")


# The views of every held-out camera begin anew, so a network enhances them beside one another: the film has the same bytes.
use rule enhance_shot as enhance_segment with:
    output:
        video=temp("results/{scene}/enhance/{shot}/{camera}.mkv"),
        film=temp("results/{scene}/enhance/{shot}/{camera}.mp4"),
        decisions=temp("results/{scene}/enhance/{shot}/{camera}.decisions.json"),
    log:
        "logs/{scene}/enhance/segment/{shot}/{camera}.log",
    benchmark:
        "timings/{scene}/enhance/segment/{shot}/{camera}.tsv"
    params:
        only="{camera}",
    message:
        "Enhance camera {wildcards.camera} of film {wildcards.shot}"
