# Plates: the room without people, from every camera.


rule plates_clean:
    input:
        video="results/{scene}/capture/{camera}.mkv",
        footage="results/{scene}/capture/{camera}.json",
        calibration="results/{scene}/calibration/calibration.json",
        detections=files.first_detection,
        given=files.given_plate,
    output:
        plate="results/{scene}/plates/{camera}.png",
    log:
        "logs/{scene}/plates/clean/{camera}.log",
    benchmark:
        "timings/{scene}/plates/clean/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1500),
    params:
        settings=settings("plates.clean"),
        code=code("plates.clean"),
    shell:
        command("plates.clean")
