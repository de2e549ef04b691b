# Which effects this scene calls for, each with a statistic and a reason: before training (a checkpoint, because jobs hang on it) and after.


checkpoint survey_decide:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model=MODEL,
        people=files.people_table,
        identities=files.identities,
        detections=files.detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        plates=collect("results/{scene}/plates/{camera}.png", camera=files.training, allow_missing=True),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=files.training, allow_missing=True),
        room_box="results/{scene}/depth/room.json",
    output:
        decisions="results/{scene}/survey/decisions.json",
        artefacts=[
            "results/{scene}/survey/gains.json",
            "results/{scene}/survey/brightness.json",
            "results/{scene}/survey/specularity.json",
        ],
    log:
        "logs/{scene}/survey/decide.log",
    benchmark:
        "timings/{scene}/survey/decide.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("survey.decide"),
        code=code("survey.decide"),
    message:
        "Measure which effects {wildcards.scene} needs"
    shell:
        command("survey.decide")
