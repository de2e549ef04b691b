# People: 2D keypoints of every camera, who is who (the checkpoint), and one body per person over time.


if BODY_SOURCE:

    rule people_bodies:
        input:
            video="results/{scene}/capture/{camera}.mkv",
            footage="results/{scene}/capture/{camera}.json",
            given=given_bodies,
        output:
            detections="results/{scene}/people/detections/{camera}.npz",
        log:
            "logs/{scene}/people/bodies/{camera}.log",
        benchmark:
            "benchmarks/{scene}/people/bodies/{camera}.tsv"
        container:
            model_image(BODY_SOURCE) if BODY_SOURCE in MODELS else image("core")
        threads: 2
        resources:
            mem_mb=8000,
            gpu=gpus(BODY_SOURCE) if BODY_SOURCE in MODELS else 0,
        params:
            settings=settings("people.bodies"),
            code=code("people.bodies"),
            weights=WEIGHTS,
            device=config["device"],
        shell:
            "python -m studiorecon people.bodies --settings {params.settings:q} --log {log}"
            " --camera {wildcards.camera:q} --video {input.video:q} --footage {input.footage:q} --given {input.given:q}"
            " --weights {params.weights:q} --device {params.device} --detections {output.detections:q}"

else:

    rule people_detect:
        input:
            source=footage_source,
            networks=DETECTOR_FILES,
        output:
            found="results/{scene}/people/found/{camera}.npz",
        log:
            "logs/{scene}/people/detect/{camera}.log",
        benchmark:
            "benchmarks/{scene}/people/detect/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=2000,
        params:
            settings=settings("people.detect"),
            code=code("people.detect"),
            start=lookup("{camera}", within=DATASET.first_frames),
            frame_count=DATASET.frame_count,
            picture_fps=config["capture"]["picture_fps"],
        shell:
            "python -m studiorecon people.detect --settings {params.settings:q} --log {log:q}"
            " --camera {wildcards.camera:q} --source {input.source:q} --start {params.start} --count {params.frame_count}"
            " --picture-fps {params.picture_fps} --networks {input.networks:q} --found {output.found:q}"

    rule people_detections:
        input:
            keypoints=keypoint_source,
            footage="results/{scene}/capture/{camera}.json",
            calibration="results/{scene}/cameras/calibration.json",
        output:
            detections="results/{scene}/people/detections/{camera}.npz",
        log:
            "logs/{scene}/people/detections/{camera}.log",
        benchmark:
            "benchmarks/{scene}/people/detections/{camera}.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=500,
        params:
            settings=settings("people.detections"),
            code=code("people.detections"),
            layout=DATASET.keypoint_layout,
            first_frame=DATASET.keypoint_first_frame,
        shell:
            "python -m studiorecon people.detections --settings {params.settings:q} --log {log}"
            " --camera {wildcards.camera} --keypoints {input.keypoints:q} --layout {params.layout} --first-frame {params.first_frame}"
            " --footage {input.footage:q} --calibration {input.calibration:q} --detections {output.detections:q}"


checkpoint people_associate:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        detections=detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
        plates=collect("results/{scene}/capture/{camera}.plate.png", camera=PLATED, allow_missing=True),
        corrected=CORRECTED,
        body=BODY,
    output:
        people="results/{scene}/people/people.tsv",
        identities="results/{scene}/people/identities.tsv",
        association="results/{scene}/people/association.json",
        who=directory("results/{scene}/people/who"),
    log:
        "logs/{scene}/people/associate.log",
    benchmark:
        "benchmarks/{scene}/people/associate.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=2000,
    params:
        settings=settings("people.associate"),
        code=code("people.associate"),
        plated=PLATED,
    shell:
        "python -m studiorecon people.associate --settings {params.settings:q} --log {log}"
        " --model {input.model[0]:q} --manifest {input.manifest:q} --detections {input.detections:q} --videos {input.videos:q}"
        " --plated {params.plated:q} --plates {input.plates:q} --corrected {input.corrected:q} --body {input.body:q}"
        " --people {output.people:q} --identities {output.identities:q} --association {output.association:q} --who {output.who:q}"


rule people_desk:
    input:
        association="results/{scene}/people/association.json",
        people="results/{scene}/people/people.tsv",
        identities="results/{scene}/people/identities.tsv",
        detections=detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
    output:
        page="results/{scene}/people/desk.html",
    log:
        "logs/{scene}/people/desk.log",
    benchmark:
        "benchmarks/{scene}/people/desk.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("people.desk"),
        code=code("people.desk"),
    shell:
        "python -m studiorecon people.desk --settings {params.settings:q} --log {log}"
        " --association {input.association:q} --people {input.people:q} --identities {input.identities:q}"
        " --detections {input.detections:q} --videos {input.videos:q} --page {output.page:q}"


rule people_fit:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        detections=detections,
        identities=tracks_of,
        standing=silhouettes_of,
        body=BODY,
    output:
        fit="results/{scene}/people/{person}.npz",
    log:
        "logs/{scene}/people/fit/{person}.log",
    benchmark:
        "benchmarks/{scene}/people/fit/{person}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=1000,
    params:
        settings=settings("people.fit"),
        code=code("people.fit"),
    shell:
        "python -m studiorecon people.fit --settings {params.settings:q} --log {log}"
        " --person {wildcards.person} --model {input.model[0]:q} --manifest {input.manifest:q} --detections {input.detections:q}"
        " --identities {input.identities:q} --standing {input.standing:q} --body {input.body:q} --fit {output.fit:q}"


rule people_overlay:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        video="results/{scene}/capture/{camera}.mkv",
        detections=branch(SIGHTED, then="results/{scene}/people/detections/{camera}.npz"),
        identities="results/{scene}/people/identities.tsv",
        fits=fits,
    output:
        film="results/{scene}/people/overlay/{camera}.mp4",
    log:
        "logs/{scene}/people/overlay/{camera}.log",
    benchmark:
        "benchmarks/{scene}/people/overlay/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=700,
    params:
        code=code("people.overlay"),
    shell:
        "python -m studiorecon people.overlay --log {log}"
        " --camera {wildcards.camera:q} --model {input.model[0]:q} --manifest {input.manifest:q} --video {input.video:q}"
        " --detections {input.detections:q} --identities {input.identities:q} --fits {input.fits:q} --film {output.film:q}"
