# Which effects this scene calls for, each with a statistic and a reason.


rule survey_decide:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model="results/{scene}/cameras/images.txt",
        people=people_table,
        identities="results/{scene}/people/identities.tsv" if DATASET.people else [],
        detections=detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
        shell="results/{scene}/depth/shell.json",
    output:
        decisions="results/{scene}/survey/decisions.json",
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
        settings=settings("survey"),
        code=code("survey.decide"),
    shell:
        "python -m studiorecon survey.decide --settings {params.settings:q} --log {log:q}"
        " --manifest {input.manifest:q} --model {input.model:q} --people {input.people:q}"
        " --identities {input.identities:q} --detections {input.detections:q} --videos {input.videos:q}"
        " --plates {input.plates:q} --depths {input.depths:q} --shell {input.shell:q} --decisions {output.decisions:q}"
