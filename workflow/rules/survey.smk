# Which effects this scene calls for, each with a statistic and a reason: before training (a checkpoint, because jobs hang on it) and after.


checkpoint survey_decide:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        people=people_table,
        identities="results/{scene}/people/identities.tsv" if DATASET.people else [],
        detections=detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
        shell="results/{scene}/depth/shell.json",
    output:
        decisions="results/{scene}/survey/decisions.json",
        gains="results/{scene}/survey/gains.json",
        course="results/{scene}/survey/course.json",
        gloss="results/{scene}/survey/gloss.json",
    log:
        "logs/{scene}/survey/decide.log",
    benchmark:
        "benchmarks/{scene}/survey/decide.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1500,
    params:
        settings=settings("survey.decide"),
        code=code("survey.decide"),
    shell:
        "python -m studiorecon survey.decide --settings {params.settings:q} --log {log:q}"
        " --manifest {input.manifest:q} --model {input.model[0]:q} --people {input.people:q}"
        " --identities {input.identities:q} --detections {input.detections:q} --videos {input.videos:q}"
        " --plates {input.plates:q} --depths {input.depths:q} --shell {input.shell:q} --decisions {output.decisions:q}"
        " --gains {output.gains:q} --course {output.course:q} --gloss {output.gloss:q}"


rule survey_trained:
    input:
        model=MODEL,
        background="results/{scene}/background/scene.ply",
        avatars=human_avatars,
        ledgers=collect("results/{scene}/render/{shot}.tsv", shot=FILMS, allow_missing=True),
        renders=collect("results/{scene}/render/{shot}.mkv", shot=FILMS, allow_missing=True),
        enhanced=collect("results/{scene}/enhance/{shot}.mkv", shot=FILMS, allow_missing=True),
        paths=collect("results/{scene}/render/{shot}.json", shot=FILMS, allow_missing=True),
    output:
        decisions="results/{scene}/survey/trained.json",
    log:
        "logs/{scene}/survey/trained.log",
    benchmark:
        "benchmarks/{scene}/survey/trained.tsv"
    container:
        image(DRAWN_BY)
    threads: 1
    resources:
        mem_mb=1500,
        gpu=DRAWING_GPUS,
    params:
        settings=settings("survey.trained"),
        code=code("survey.trained"),
        history=section("enhance")["injection"]["history"],
        device=config["device"],
    shell:
        "python -m studiorecon survey.trained --settings {params.settings:q} --log {log:q} --device {params.device}"
        " --model {input.model[0]:q} --background {input.background:q} --avatars {input.avatars:q} --ledgers {input.ledgers:q}"
        " --renders {input.renders:q} --enhanced {input.enhanced:q} --paths {input.paths:q} --history {params.history}"
        " --decisions {output.decisions:q}"
