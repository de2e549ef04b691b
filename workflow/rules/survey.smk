rule survey_decide:
    input:
        manifest="results/{scene}/capture/manifest.json",
        model="results/{scene}/cameras/images.txt",
        people=people_table,
        plates=collect("results/{scene}/capture/{camera}.plate.png", camera=TRAINING, allow_missing=True),
        depths=collect("results/{scene}/depth/{camera}.exr", camera=TRAINING, allow_missing=True),
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
        mem_mb=1000,
    params:
        settings=settings("survey"),
        code=code("survey.decide"),
    shell:
        "python -m studiorecon survey.decide --settings {params.settings:q} --log {log:q}"
        " --manifest {input.manifest:q} --model {input.model:q} --people {input.people:q}"
        " --plates {input.plates:q} --depths {input.depths:q} --decisions {output.decisions:q}"
