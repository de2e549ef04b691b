# New views between the cameras: the path, then one job per gap between neighbours, by warping or by GEN3C (views.synthesizer).


rule views_path:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
    output:
        path="results/{scene}/views/path.json",
    log:
        "logs/{scene}/views/path.log",
    benchmark:
        "benchmarks/{scene}/views/path.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        settings=settings("views.path"),
        code=code("views.path"),
    shell:
        "python -m studiorecon views.path --settings {params.settings:q} --log {log}"
        " --model {input.model[0]:q} --manifest {input.manifest} --path {output.path}"


if SYNTHESIZER == "warp":

    rule views_synthesize:
        input:
            path="results/{scene}/views/path.json",
            model=MODEL,
            plates=collect(
                "results/{scene}/capture/{camera}.plate.png",
                camera=TRAINING,
                allow_missing=True,
            ),
            depth=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
            exposure=gains,
        output:
            views="results/{scene}/views/{segment}.mkv",
            support="results/{scene}/views/{segment}.mask.mkv",
        log:
            "logs/{scene}/views/{segment}.log",
        benchmark:
            "benchmarks/{scene}/views/{segment}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=1500,
        params:
            settings=settings("views.synthesize"),
            code=code("views.synthesize"),
        shell:
            "python -m studiorecon views.synthesize --settings {params.settings:q} --log {log}"
            " --segment {wildcards.segment} --path {input.path} --model {input.model[0]:q} --plates {input.plates:q}"
            " --depth {input.depth:q} --exposure {input.exposure:q} --views {output.views} --support {output.support}"


if SYNTHESIZER == "gen3c":

    rule views_request:
        input:
            path="results/{scene}/views/path.json",
            model=MODEL,
            plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
            depth=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
            exposure=gains,
        output:
            request="results/{scene}/views/{segment}.request.npz",
        log:
            "logs/{scene}/views/request/{segment}.log",
        benchmark:
            "benchmarks/{scene}/views/request/{segment}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=3000,
        params:
            settings=settings("views.request"),
            code=code("views.request"),
        shell:
            "python -m studiorecon views.request --settings {params.settings:q} --log {log}"
            " --segment {wildcards.segment} --path {input.path} --model {input.model[0]:q} --plates {input.plates:q}"
            " --depth {input.depth:q} --exposure {input.exposure:q} --request {output.request}"

    # One segment, one job, one GPU: on a cluster they run side by side, and a finished one stays.
    rule views_generate:
        input:
            request="results/{scene}/views/{segment}.request.npz",
        output:
            film="results/{scene}/views/{segment}.film.mkv",
        log:
            "logs/{scene}/views/generate/{segment}.log",
        benchmark:
            "benchmarks/{scene}/views/generate/{segment}.tsv"
        container:
            model_image("gen3c")
        threads: 4
        resources:
            mem_mb=64000,
            gpu=1,
        params:
            settings=settings("views.generate"),
            code=code("views.generate"),
            weights=WEIGHTS,
        shell:
            "python -m studiorecon views.generate --settings {params.settings:q} --log {log}"
            " --requests {input.request} --films {output.film} --weights {params.weights:q}"


if SYNTHESIZER != "warp":

    rule views_fitted:
        input:
            film=generated_film,
            path="results/{scene}/views/path.json",
            model=MODEL,
            plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
            depth=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
            exposure=gains,
        output:
            views="results/{scene}/views/{segment}.mkv",
            support="results/{scene}/views/{segment}.mask.mkv",
        log:
            "logs/{scene}/views/{segment}.log",
        benchmark:
            "benchmarks/{scene}/views/{segment}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=2000,
        params:
            settings=settings("views.fitted"),
            code=code("views.fitted"),
        shell:
            "python -m studiorecon views.fitted --settings {params.settings:q} --log {log}"
            " --segment {wildcards.segment} --film {input.film:q} --path {input.path} --model {input.model[0]:q} --plates {input.plates:q}"
            " --depth {input.depth:q} --exposure {input.exposure:q} --views {output.views} --support {output.support}"
