# People: who is who (the checkpoint), and one body per person over time.
# The detector looks twice: tracks/ is what a camera alone says, people/detections what all of them together say.


checkpoint people_associate:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        detections=files.association_detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
        corrected=files.corrected_identities,
        calibration="results/{scene}/calibration/calibration.json",
        found=files.raw_detections,
        plates=files.own_plates,
    output:
        people="results/{scene}/people/people.tsv",
        identities="results/{scene}/people/identities.tsv",
        association="results/{scene}/people/association.json",
        who=directory("results/{scene}/people/who"),
    log:
        "logs/{scene}/people/associate.log",
    benchmark:
        "timings/{scene}/people/associate.tsv"
    # The room is fitted after people are found, and everything that is drawn after the room.
    priority: 6
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(2000),
    params:
        settings=settings("people.associate"),
        code=code("people.associate"),
    message:
        "Associate people across cameras"
    shell:
        command("people.associate")


if PLAN.lifts_pelvises:

    # Where people stand by the depth of the scene, the paper's way.
    rule people_lift:
        input:
            model=MODEL,
            video="results/{scene}/capture/{camera}.mkv",
            detections=files.detection,
            first="results/{scene}/calibration/network/{camera}.exr",
            found="results/{scene}/calibration/network/images.txt",
        output:
            lifted_detections="results/{scene}/people/lifted/{camera}.npz",
        log:
            "logs/{scene}/people/lift/{camera}.log",
        benchmark:
            "timings/{scene}/people/lift/{camera}.tsv"
        container:
            model_image(PLAN.networks.depth)
        threads: 1
        resources:
            mem_mb=memory(16000),
            gpu=gpus(PLAN.networks.depth),
        params:
            settings=settings("people.lift"),
            code=code("people.lift"),
            network=PLAN.networks.depth,
            weights=PLAN.networks.weights,
            device=config["device"],
        shell:
            command("people.lift")


if files.corrected_identities:

    # Who is who without the user's word, which it is then measured against.
    use rule people_associate as people_by_itself with:
        input:
            model=MODEL,
            manifest="results/{scene}/capture/manifest.json",
            detections=files.association_detections,
            videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
            corrected=[],
            calibration="results/{scene}/calibration/calibration.json",
            found=files.raw_detections,
            plates=files.own_plates,
        output:
            people="results/{scene}/people/by_itself/people.tsv",
            identities="results/{scene}/people/by_itself/identities.tsv",
            association="results/{scene}/people/by_itself/association.json",
            who=directory("results/{scene}/people/by_itself/who"),
        log:
            "logs/{scene}/people/by_itself/associate.log",
        benchmark:
            "timings/{scene}/people/by_itself/associate.tsv"


if PLAN.person_sources.detector_cameras:

    # Who is who before the second look, which nobody's corrections are about.
    use rule people_associate as people_first_associate with:
        input:
            model=MODEL,
            manifest="results/{scene}/capture/manifest.json",
            detections=files.first_detections,
            videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
            corrected=[],
            calibration="results/{scene}/calibration/calibration.json",
            found=files.first_raw_detections,
            plates=files.own_plates,
        output:
            people="results/{scene}/people/first/people.tsv",
            identities="results/{scene}/people/first/identities.tsv",
            association="results/{scene}/people/first/association.json",
            who=directory("results/{scene}/people/first/who"),
        log:
            "logs/{scene}/people/first/associate.log",
        benchmark:
            "timings/{scene}/people/first/associate.tsv"

    rule people_second_look:
        input:
            source=files.footage,
            networks=files.detector,
            second=files.second_network,
            hand_network=files.hand_network,
            model=MODEL,
            manifest="results/{scene}/capture/manifest.json",
            clocks="results/{scene}/clocks/clocks.json",
            calibration="results/{scene}/calibration/calibration.json",
            body=files.body,
            first=files.first_detections,
            identities="results/{scene}/people/first/identities.tsv",
            found="results/{scene}/detect/found/{camera}.npz",
        output:
            detections="results/{scene}/people/detections/{camera}.npz",
            seen="results/{scene}/people/seen/{camera}.npz",
            report="results/{scene}/people/seen/{camera}.json",
        log:
            "logs/{scene}/people/second_look/{camera}.log",
        benchmark:
            "timings/{scene}/people/second_look/{camera}.tsv"
        wildcard_constraints:
            camera=camera_pattern(PLAN.person_sources.detector_cameras),
        # As for who is who.
        priority: 6
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=memory(1500),
        params:
            settings=settings("people.second_look"),
            code=code("people.second_look"),
            layout=config["detect"]["network_layout"],
            picture_fps=config["capture"]["picture_fps"],
        shell:
            command("people.second_look")


rule people_review:
    input:
        association="results/{scene}/people/association.json",
        people="results/{scene}/people/people.tsv",
        identities="results/{scene}/people/identities.tsv",
        detections=files.detections,
        videos=collect("results/{scene}/capture/{camera}.mkv", camera=files.training, allow_missing=True),
    output:
        page="results/{scene}/people/review.html",
    log:
        "logs/{scene}/people/review.log",
    benchmark:
        "timings/{scene}/people/review.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        code=code("people.review"),
    shell:
        command("people.review")


rule people_fit:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        detections=files.detections,
        identities=files.person_tracks,
        readouts=files.readouts_for,
        body=files.body,
    output:
        fit="results/{scene}/people/{person}.npz",
    log:
        "logs/{scene}/people/fit/{person}.log",
    benchmark:
        "timings/{scene}/people/fit/{person}.tsv"
    # As for who is who.
    priority: 6
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(fit_mb(config)),
    params:
        settings=settings("people.fit"),
        code=code("people.fit"),
    shell:
        command("people.fit")


rule people_overlay:
    input:
        model=MODEL,
        manifest="results/{scene}/capture/manifest.json",
        video="results/{scene}/capture/{camera}.mkv",
        detections=files.detection,
        identities="results/{scene}/people/identities.tsv",
        fits=files.fits,
    output:
        film="results/{scene}/people/overlay/{camera}.mp4",
    log:
        "logs/{scene}/people/overlay/{camera}.log",
    benchmark:
        "timings/{scene}/people/overlay/{camera}.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(700),
    params:
        code=code("people.overlay"),
    shell:
        command("people.overlay")
