/* SPDX-License-Identifier: Apache-2.0 */
/* Denoises a picture in the caller's own memory. Build it against an installed Quell:
 *
 *     cc -o denoise_buffer denoise_buffer.c $(pkg-config --cflags --libs quell)
 *
 * The picture is a made one: two flat surfaces under noise, and beside it the albedo that Cycles would give. */
#include <quell.h>

#include <stdio.h>
#include <stdlib.h>

enum { WIDTH = 320, HEIGHT = 200 };

static float color[HEIGHT][WIDTH][4]; /* RGBA, scene-linear, row 0 on top */
static float albedo[HEIGHT][WIDTH][3];

static float random_float(void)
{
    return (float)rand() / (float)RAND_MAX;
}

static void make_picture(void)
{
    for (int y = 0; y < HEIGHT; y++) {
        for (int x = 0; x < WIDTH; x++) {
            const float surface = x < WIDTH / 2 ? 0.2f : 0.8f;
            for (int c = 0; c < 3; c++) {
                albedo[y][x][c] = surface;
                color[y][x][c] = surface * 2.0f * random_float(); /* as if few samples had been taken */
            }
            color[y][x][3] = 1.0f;
        }
    }
}

static double error_against_truth(void)
{
    double sum = 0.0;
    for (int y = 0; y < HEIGHT; y++) {
        for (int x = 0; x < WIDTH; x++) {
            const double difference = (double)color[y][x][0] - (double)albedo[y][x][0];
            sum += difference * difference;
        }
    }
    return sum / (WIDTH * HEIGHT);
}

int main(void)
{
    quell_context *ctx = NULL;
    quell_model *model = NULL;
    quell_frame *frame = NULL;
    quell_image image = {.struct_size = sizeof image, .width = WIDTH, .height = HEIGHT, .num_channels = 4};
    quell_image guide = {.struct_size = sizeof guide, .width = WIDTH, .height = HEIGHT, .num_channels = 3};
    image.data = color;
    guide.data = albedo;

    make_picture();
    printf("error before %.5f\n", error_against_truth());

    quell_status status = quell_context_create(NULL, &ctx);
    if (status == QUELL_OK) status = quell_model_open(ctx, NULL, &model);
    if (status == QUELL_OK) status = quell_frame_create(ctx, WIDTH, HEIGHT, &frame);
    /* Borrowed: the result is written where the noisy picture stood. */
    const int32_t borrow = QUELL_LAYER_BORROW;
    if (status == QUELL_OK) status = quell_frame_add_layer(ctx, frame, "Combined", &image, borrow, NULL);
    if (status == QUELL_OK) status = quell_frame_add_layer(ctx, frame, "Denoising Albedo", &guide, borrow, NULL);
    if (status == QUELL_OK) status = quell_frame_set_samples(frame, 4);
    if (status == QUELL_OK) status = quell_denoise(ctx, model, frame, NULL, NULL);

    if (status != QUELL_OK) fprintf(stderr, "%s: %s\n", quell_status_name(status), quell_context_last_error(ctx));
    printf("error after  %.5f\n", error_against_truth());
    quell_frame_destroy(frame);
    quell_model_destroy(model);
    quell_context_destroy(ctx);
    return status == QUELL_OK ? 0 : 1;
}
