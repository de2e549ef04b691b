# New views between the cameras: the path, then one job per gap between neighbours.


rule views_path:
    input:
        model="results/{scene}/cameras/images.txt",
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
        settings=settings("views"),
        code=code("views.path"),
    shell:
        "python -m studiorecon views.path --settings {params.settings:q} --log {log}"
        " --model {input.model} --manifest {input.manifest} --path {output.path}"


rule views_synthesize:
    input:
        path="results/{scene}/views/path.json",
        model="results/{scene}/cameras/images.txt",
        plates=collect(
            "results/{scene}/capture/{camera}.plate.png",
            camera=TRAINING,
            allow_missing=True,
        ),
        depth=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
        shell="results/{scene}/depth/shell.json",
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
        settings=settings("views"),
        code=code("views.synthesize"),
    shell:
        "python -m studiorecon views.synthesize --settings {params.settings:q} --log {log}"
        " --segment {wildcards.segment} --path {input.path} --model {input.model} --plates {input.plates:q}"
        " --depth {input.depth:q} --shell {input.shell} --views {output.views} --support {output.support}"
