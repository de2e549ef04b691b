# How good the result is, and one page that shows everything.


rule report_audit:
    input:
        avatars=files.human_avatars,
        films=collect("results/{scene}/enhance/{shot}.decisions.json", shot=files.films, allow_missing=True),
    output:
        decisions="results/{scene}/report/audit.json",
    log:
        "logs/{scene}/report/audit.log",
    benchmark:
        "timings/{scene}/report/audit.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        settings=settings("report.audit"),
        code=code("report.audit"),
    shell:
        command("report.audit")


# Whom the detector finds in the films, against whom it finds in the photos of the same cameras.
rule report_recognition:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        heldout_model=HELDOUT_MODEL,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.evaluated_cameras, allow_missing=True),
        render=collect("results/{scene}/render/{shot}.mkv", shot=files.evaluated_film, allow_missing=True),
        render_path=collect("results/{scene}/render/{shot}.json", shot=files.evaluated_film, allow_missing=True),
        enhanced=collect("results/{scene}/enhance/{shot}.mkv", shot=files.heldout_film, allow_missing=True),
        networks=files.detector,
    output:
        recognition="results/{scene}/report/recognition.json",
    log:
        "logs/{scene}/report/recognition.log",
    benchmark:
        "timings/{scene}/report/recognition.tsv"
    # The page waits for it, and for what is measured after it, longer than for anything beside it.
    priority: 20
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        code=code("report.recognition"),
    shell:
        command("report.recognition")


rule report_evaluate:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        heldout_model=HELDOUT_MODEL,
        poses="results/{scene}/cameras/heldout/poses.json",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.evaluated_cameras, allow_missing=True),
        render=collect(
            "results/{scene}/render/{shot}.mkv",
            shot=files.evaluated_film,
            allow_missing=True,
        ),
        render_path=collect(
            "results/{scene}/render/{shot}.json",
            shot=files.evaluated_film,
            allow_missing=True,
        ),
        enhanced=collect("results/{scene}/enhance/{shot}.mkv", shot=files.heldout_film, allow_missing=True),
        truth_maps=collect("results/{scene}/render/{shot}.truth.mkv", shot=files.films, allow_missing=True),
        fits=files.fits,
        detections=files.detections,
        identities=files.identities,
        uncorrected_identities=files.uncorrected_identities,
        truth=files.truth,
        film_depth=files.film_depth,
        room_depths=files.region_depths,
        room_masks=files.region_masks,
        body=files.region_body,
    output:
        metrics="results/{scene}/report/metrics.json",
    log:
        "logs/{scene}/report/evaluate.log",
    benchmark:
        "timings/{scene}/report/evaluate.tsv"
    priority: 20
    container:
        image(PLAN.networks.rasteriser_image)
    threads: 1  # of two, all but LPIPS would leave one idle
    resources:
        mem_mb=memory(drawn_mb(PLAN, 1500)),
        gpu=PLAN.networks.rasteriser_gpus if PLAN.networks.lpips("report") != "none" else 0,
    params:
        settings=settings("report.evaluate"),
        code=code("report.evaluate"),
        calibrator=PLAN.networks.cameras or "none",
        lpips=PLAN.networks.lpips("report"),
        device=config["device"] if PLAN.networks.lpips("report") != "none" else "cpu",
    shell:
        command("report.evaluate")


rule report_page:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        metrics="results/{scene}/report/metrics.json",
        recognition=files.recognition,
        decisions=["results/{scene}/survey/decisions.json", "results/{scene}/report/audit.json"],
        refinement="results/{scene}/cameras/refinement.json",
        sheet="results/{scene}/cameras/refinement.png",
        # Shown by the names that they have: the step finds them beside the manifest.
        plates=collect(
            "results/{scene}/plates/{camera}.png",
            camera=files.training,
            allow_missing=True,
        ),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=files.training, allow_missing=True),
        training_videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        masks=files.masks,
        films=collect("results/{scene}/enhance/{shot}.mp4", shot=files.films, allow_missing=True),
        renders=collect("results/{scene}/render/{shot}.mkv", shot=files.films, allow_missing=True),
        paths=collect("results/{scene}/render/{shot}.json", shot=files.films, allow_missing=True),
        ledgers=collect("results/{scene}/render/{shot}.tsv", shot=files.films, allow_missing=True),
        truth_maps=collect("results/{scene}/render/{shot}.truth.mkv", shot=files.films, allow_missing=True),
        heldout_videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.held_out, allow_missing=True),
        heldout_render=collect(
            "results/{scene}/render/{shot}.mkv",
            shot=files.heldout_film,
            allow_missing=True,
        ),
        heldout_enhanced=collect(
            "results/{scene}/enhance/{shot}.mkv",
            shot=files.heldout_film,
            allow_missing=True,
        ),
        heldout_path=collect(
            "results/{scene}/render/{shot}.json",
            shot=files.heldout_film,
            allow_missing=True,
        ),
        fits=files.fits,
        detections=files.detections,
        identities=files.identities,
        association=files.association,
        paper=files.bundled("resources/paper/results.tsv"),
        poster="results/{scene}/deliver/player.jpg",
        # Only linked: the page comes last, and counts what they cost.
        linked=[
            *(["results/{scene}/people/review.html"] if PLAN.people else []),
            "results/{scene}/depth/room.json",
            "results/{scene}/deliver/manifest.json",
            "results/{scene}/deliver/player.html",
            "results/{scene}/deliver/scene.glb",
        ],
    output:
        costs="results/{scene}/report/cost.json",
        page=report(
            "results/{scene}/report/index.html",
            caption="../report/page.rst",
            category="Result",
        ),
    log:
        "logs/{scene}/report/page.log",
    benchmark:
        "timings/{scene}/report/page.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("report.page"),
        code=code("report.page"),
        configuration=step_config.report_settings(config),
        budget=json.dumps(BUDGET),
        benchmarks="timings/{scene}",
        logs="logs/{scene}",
        licences=HOME / "resources/licences",
    message:
        "Write the report: {output.page}"
    shell:
        command("report.page")


# Asked for with strict: the page comes first, so that nothing is lost by it.
rule report_strict:
    input:
        page="results/{scene}/report/index.html",
    output:
        passed="results/{scene}/report/strict.txt",
    log:
        "logs/{scene}/report/strict.log",
    benchmark:
        "timings/{scene}/report/strict.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        code=code("report.strict"),
        logs="logs/{scene}",
    shell:
        command("report.strict")
