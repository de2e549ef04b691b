# SPDX-License-Identifier: Apache-2.0
"""SAM 3's video network, as small as its classes allow, with random weights."""

from __future__ import annotations

from typing import Any


def tiny_session() -> tuple[Any, Any, tuple[int, int]]:
    """The network, a session of four random frames that looks for one word, and the frames' size."""
    import torch
    from transformers.models.sam3_video import modeling_sam3_video as modeling
    from transformers.models.sam3_video.configuration_sam3_video import Sam3VideoConfig

    side = 112
    vision = {
        "model_type": "sam3_vit_model",
        "hidden_size": 32,
        "intermediate_size": 64,
        "num_hidden_layers": 2,
        "num_attention_heads": 2,
        "image_size": side,
        "window_size": 4,
        "global_attn_indexes": [1],
        "pretrain_image_size": side,
    }
    detector = {
        "vision_config": {
            "model_type": "sam3_vision_model",
            "backbone_config": vision,
            "fpn_hidden_size": 256,
            "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]],
        },
        "text_config": {
            "model_type": "clip_text_model",
            "vocab_size": 64,
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "max_position_embeddings": 32,
            "projection_dim": 32,
        },
        "geometry_encoder_config": {
            "hidden_size": 256,
            "num_layers": 1,
            "num_attention_heads": 2,
            "intermediate_size": 64,
        },
        "detr_encoder_config": {"hidden_size": 256, "num_layers": 1, "num_attention_heads": 2, "intermediate_size": 64},
        "detr_decoder_config": {
            "hidden_size": 256,
            "num_layers": 1,
            "num_queries": 6,
            "num_attention_heads": 2,
            "intermediate_size": 64,
        },
        "mask_decoder_config": {"hidden_size": 256, "num_attention_heads": 2},
    }
    tracker = {"model_type": "sam3_tracker_video", "image_size": side, "vision_config": detector["vision_config"]}
    settings = Sam3VideoConfig(
        detector_config=detector,
        tracker_config=tracker,
        low_res_mask_size=32,
        hotstart_delay=0,
        fill_hole_area=0,
        score_threshold_detection=0.0,
        new_det_thresh=0.0,
    )
    torch.manual_seed(0)
    network = modeling.Sam3VideoModel(settings).eval()
    hw = (90, 120)
    session = modeling.Sam3VideoInferenceSession(
        video=torch.randn(4, 3, side, side),
        video_height=hw[0],
        video_width=hw[1],
        inference_device="cpu",
        inference_state_device="cpu",
        video_storage_device="cpu",
        dtype=torch.float32,
    )
    word = session.add_prompt("person")
    session.prompt_input_ids[word] = torch.zeros(1, 32, dtype=torch.long)
    session.prompt_attention_masks[word] = torch.ones(1, 32, dtype=torch.long)
    return network, session, hw
