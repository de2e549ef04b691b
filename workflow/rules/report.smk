# How good the result is, and one page that shows everything.


rule report_evaluate:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        heldout_model=HELDOUT_MODEL,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=HELDOUT or TRAINING, allow_missing=True),
        render=collect(
            "results/{scene}/render/{shot}.mkv",
            shot=[s for s in SHOTS if s == ("heldout" if HELDOUT else "train")],
            allow_missing=True,
        ),
        render_path=collect(
            "results/{scene}/render/{shot}.json",
            shot=[s for s in SHOTS if s == ("heldout" if HELDOUT else "train")],
            allow_missing=True,
        ),
        enhanced=collect("results/{scene}/enhance/{shot}.mkv", shot=[s for s in FILMS if s == "heldout"], allow_missing=True),
        truth_maps=collect("results/{scene}/render/{shot}.truth.mkv", shot=FILMS, allow_missing=True),
        fits=fits,
        detections=detections,
        identities="results/{scene}/people/identities.tsv" if DATASET.people else [],
        truth=[in_dataset(DATASET.truth)] if DATASET.truth else [],
    output:
        metrics="results/{scene}/report/metrics.json",
    log:
        "logs/{scene}/report/evaluate.log",
    benchmark:
        "benchmarks/{scene}/report/evaluate.tsv"
    container:
        image(DRAWN_BY)
    threads: 2
    resources:
        mem_mb=1500,
    params:
        settings=settings("report.evaluate"),
        code=code("report.evaluate"),
    shell:
        "python -m studiorecon report.evaluate --settings {params.settings:q} --log {log}"
        " --scene {wildcards.scene} --manifest {input.manifest} --model {input.model[0]:q} --heldout-model {input.heldout_model[0]:q}"
        " --videos {input.videos:q} --render {input.render:q} --render-path {input.render_path:q} --enhanced {input.enhanced:q}"
        " --truth-maps {input.truth_maps:q} --fits {input.fits:q} --detections {input.detections:q}"
        " --identities {input.identities:q} --truth {input.truth:q} --threads {threads} --metrics {output.metrics}"


rule report_page:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        metrics="results/{scene}/report/metrics.json",
        decisions=collect("results/{scene}/survey/{decided}.json", decided=["decisions", "trained"], allow_missing=True),
        refinement="results/{scene}/cameras/refinement.json",
        sheet="results/{scene}/cameras/refinement.png",
        plates=collect(
            "results/{scene}/capture/{camera}.plate.png",
            camera=TRAINING,
            allow_missing=True,
        ),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
        training_videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        masks=masks,
        films=collect("results/{scene}/enhance/{shot}.mp4", shot=FILMS, allow_missing=True),
        renders=collect("results/{scene}/render/{shot}.mkv", shot=FILMS, allow_missing=True),
        paths=collect("results/{scene}/render/{shot}.json", shot=FILMS, allow_missing=True),
        ledgers=collect("results/{scene}/render/{shot}.tsv", shot=FILMS, allow_missing=True),
        truth_maps=collect("results/{scene}/render/{shot}.truth.mkv", shot=FILMS, allow_missing=True),
        heldout_videos=collect("results/{scene}/capture/{camera}.mkv", camera=HELDOUT, allow_missing=True),
        heldout_render=collect(
            "results/{scene}/render/{shot}.mkv",
            shot=[s for s in FILMS if s == "heldout"],
            allow_missing=True,
        ),
        heldout_enhanced=collect(
            "results/{scene}/enhance/{shot}.mkv",
            shot=[s for s in FILMS if s == "heldout"],
            allow_missing=True,
        ),
        heldout_path=collect(
            "results/{scene}/render/{shot}.json",
            shot=[s for s in FILMS if s == "heldout"],
            allow_missing=True,
        ),
        fits=fits,
        detections=detections,
        identities="results/{scene}/people/identities.tsv" if DATASET.people else [],
        paper=local(str(Path(workflow.basedir) / "resources/paper/results.tsv")),
        solvers=local(str(Path(workflow.basedir) / "resources/solvers.tsv")),
        # Only linked: the page comes last, and counts what they cost.
        linked=[
            *(["results/{scene}/people/desk.html"] if DATASET.people else []),
            "results/{scene}/depth/shell.json",
            "results/{scene}/deliver/manifest.json",
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
        "benchmarks/{scene}/report/page.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("report.page"),
        code=code("report.page"),
        configuration=json.dumps(shown_settings(), sort_keys=True),
        benchmarks="benchmarks/{scene}",
        logs="logs/{scene}",
        licences=Path(workflow.basedir) / "resources/licences",
        # Shown where a sweep was run; never asked for.
        sweeps=SWEEPS,
        swept=[Path(records).stat().st_mtime_ns for records in SWEEPS],
    shell:
        "python -m studiorecon report.page --settings {params.settings:q} --log {log}"
        " --scene {wildcards.scene} --manifest {input.manifest} --model {input.model[0]:q} --metrics {input.metrics}"
        " --decisions {input.decisions:q} --refinement {input.refinement} --sheet {input.sheet} --plates {input.plates:q}"
        " --depths {input.depths:q} --training-videos {input.training_videos:q} --masks {input.masks:q} --films {input.films:q}"
        " --renders {input.renders:q} --paths {input.paths:q} --ledgers {input.ledgers:q} --truth-maps {input.truth_maps:q} --heldout-videos {input.heldout_videos:q}"
        " --heldout-render {input.heldout_render:q} --heldout-enhanced {input.heldout_enhanced:q}"
        " --heldout-path {input.heldout_path:q} --fits {input.fits:q} --detections {input.detections:q}"
        " --identities {input.identities:q} --linked {input.linked:q} --benchmarks {params.benchmarks} --logs {params.logs} --configuration {params.configuration:q}"
        " --licences {params.licences:q} --paper {input.paper:q} --solvers {input.solvers:q} --sweeps {params.sweeps:q} --costs {output.costs} --page {output.page}"
