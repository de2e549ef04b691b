# Objects: loose and held things, as rigid sets of Gaussians that move.


# Where the survey finds things that move: what they are and where they go, from what no body explains.
rule objects_find:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
        fits=files.fits,
        body=files.body,
        gains=files.gains,
        brightness=files.brightness,
    output:
        objects="results/{scene}/objects/objects.npz",
    log:
        "logs/{scene}/objects/find.log",
    benchmark:
        "timings/{scene}/objects/find.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("objects.find"),
        code=code("objects.find"),
    shell:
        command("objects.find")
