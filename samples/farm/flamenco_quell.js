// SPDX-License-Identifier: Apache-2.0
// Flamenco job type: renders an animation with the add-on denoising each frame inside the render. Put it into the folder
// scripts/ beside the Manager. Workers need Blender with the add-on enabled in the preferences.
//
// Frames that are there are not rendered again, so a job that is sent twice goes on where it stopped.

const JOB_TYPE = {
    label: "Render with Quell",
    description: "Renders with Cycles; Quell denoises each frame before it is composited and saved",
    settings: [
        { key: "frames", type: "string", required: true, eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          description: "Frames to render, such as 47, 1-30, 3, 5-10" },
        { key: "chunk_size", type: "int32", default: 5, description: "Frames in one task" },
        { key: "quality", type: "string", choices: ["FAST", "BALANCED", "HIGH"], default: "BALANCED",
          description: "Better ones take longer" },
        { key: "passes", type: "string", choices: ["ALL", "COMBINED"], default: "ALL",
          description: "All light passes, or Combined alone" },
        { key: "keep_noisy", type: "bool", default: false, description: "Keep the noisy picture as a pass" },
        { key: "render_output_path", type: "string", subtype: "file_path", required: true, editable: true,
          eval: "bpy.path.abspath(C.scene.render.filepath)",
          description: "Where the frames go; with # for the frame's number" },
        { key: "blendfile", type: "string", required: true, visible: "web", description: "The .blend to render" },
        { key: "format", type: "string", required: true, visible: "web", eval: "C.scene.render.image_settings.file_format",
          description: "File format of the frames" },
    ],
};

// Runs in Blender after the file is loaded. An add-on that is not there makes the task fail, not the picture noisy.
function quellSettings(settings) {
    return [
        "import bpy, sys",
        "q = getattr(bpy.context.scene, 'quell', None)",
        "q or sys.exit('the Quell add-on is not enabled on this worker')",
        "q.when = 'ALWAYS'",
        "q.quality = '" + settings.quality + "'",
        "q.layers = '" + settings.passes + "'",
        "q.keep_noisy = " + (settings.keep_noisy ? "True" : "False"),
        "q.enabled = True",
        "bpy.context.scene.render.use_overwrite = False",
        "bpy.context.scene.render.use_placeholder = False",
    ].join("; ");
}

function compileJob(job) {
    const settings = job.settings;
    for (const chunk of frameChunker(settings.frames, settings.chunk_size)) {
        const task = author.Task("render-" + chunk, "blender");
        task.addCommand(author.Command("blender-render", {
            exe: "{blender}",
            exeArgs: "{blenderArgs}",
            argsBefore: [],
            blendfile: settings.blendfile,
            args: [
                "--python-exit-code", "1",
                "--python-expr", quellSettings(settings),
                "--render-output", settings.render_output_path,
                "--render-format", settings.format,
                "--render-frame", chunk.replaceAll("-", ".."),
            ],
        }));
        job.addTask(task);
    }
}
