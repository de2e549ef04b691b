# People: who is found in every camera's pictures, or recorded keypoints; who is who (the checkpoint); one body per person over time.
# What the detector found goes through two looks: people/first is what a camera alone says, people/detections what all of them say.

import re

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
            clocks=branch(PART_USED, then="results/{scene}/capture/clocks.json"),
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
            code=code("people.detect"),
            picture_fps=config["capture"]["picture_fps"],
        shell:
            "python -m studiorecon people.detect --log {log:q}"
            " --camera {wildcards.camera:q} --source {input.source:q} --clocks {input.clocks:q}"
            " --picture-fps {params.picture_fps} --networks {input.networks:q} --found {output.found:q}"

    rule people_detections:
        input:
            keypoints=keypoint_source,
            clocks="results/{scene}/capture/clocks.json",
            footage="results/{scene}/capture/{camera}.json",
            calibration="results/{scene}/cameras/calibration.json",
        output:
            detections="results/{scene}/people/detections/{camera}.npz",
        log:
            "logs/{scene}/people/detections/{camera}.log",
        benchmark:
            "benchmarks/{scene}/people/detections/{camera}.tsv"
        wildcard_constraints:
            camera="|".join(map(re.escape, [c for c in CAMERAS if c not in DETECTED])) or "^$",
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
            " --clocks {input.clocks:q} --footage {input.footage:q} --calibration {input.calibration:q}"
            " --detections {output.detections:q}"

    use rule people_detections as people_first_detections with:
        output:
            detections="results/{scene}/people/first/{camera}.npz",
        log:
            "logs/{scene}/people/first/{camera}.log",
        benchmark:
            "benchmarks/{scene}/people/first/{camera}.tsv"
        wildcard_constraints:
            camera="|".join(map(re.escape, DETECTED)) or "^$",

    # Who is who before the second look: the same step, from the first detections, without clean plates and without anybody's corrections.
    rule people_first_associate:
        input:
            model=MODEL,
            manifest="results/{scene}/capture/manifest.json",
            detections=first_detections,
            videos=collect("results/{scene}/capture/{camera}.mkv", camera=TRAINING, allow_missing=True),
            body=BODY,
        output:
            people="results/{scene}/people/first/people.tsv",
            identities="results/{scene}/people/first/identities.tsv",
            association="results/{scene}/people/first/association.json",
            who=directory("results/{scene}/people/first/who"),
        log:
            "logs/{scene}/people/first/associate.log",
        benchmark:
            "benchmarks/{scene}/people/first/associate.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=2000,
        params:
            settings=settings("people.associate"),
            code=code("people.associate"),
        shell:
            "python -m studiorecon people.associate --settings {params.settings:q} --log {log}"
            " --model {input.model[0]:q} --manifest {input.manifest:q} --detections {input.detections:q} --videos {input.videos:q}"
            " --plated --plates --corrected --body {input.body:q}"
            " --people {output.people:q} --identities {output.identities:q} --association {output.association:q} --who {output.who:q}"

    rule people_second_look:
        input:
            source=footage_source,
            networks=DETECTOR_FILES,
            model=MODEL,
            manifest="results/{scene}/capture/manifest.json",
            clocks="results/{scene}/capture/clocks.json",
            calibration="results/{scene}/cameras/calibration.json",
            body=BODY,
            first=first_detections,
            identities="results/{scene}/people/first/identities.tsv",
            found="results/{scene}/people/found/{camera}.npz",
        output:
            detections="results/{scene}/people/detections/{camera}.npz",
            seen="results/{scene}/people/seen/{camera}.npz",
            report="results/{scene}/people/seen/{camera}.json",
        log:
            "logs/{scene}/people/second_look/{camera}.log",
        benchmark:
            "benchmarks/{scene}/people/second_look/{camera}.tsv"
        wildcard_constraints:
            camera="|".join(map(re.escape, DETECTED)) or "^$",
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=1500,
        params:
            settings=settings("people.second_look"),
            code=code("people.second_look"),
            picture_fps=config["capture"]["picture_fps"],
        shell:
            "python -m studiorecon people.second_look --settings {params.settings:q} --log {log:q}"
            " --camera {wildcards.camera:q} --source {input.source:q} --clocks {input.clocks:q} --picture-fps {params.picture_fps} --networks {input.networks:q}"
            " --model {input.model[0]:q} --manifest {input.manifest:q} --calibration {input.calibration:q} --body {input.body:q}"
            " --first {input.first:q} --identities {input.identities:q} --found {input.found:q}"
            " --detections {output.detections:q} --seen {output.seen:q} --report {output.report:q}"


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
