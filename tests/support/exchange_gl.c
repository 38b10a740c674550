/* Draws points with given normals by OpenGL's fixed function, as float radiance, unclamped.
   Reads: own_lights width height lights; width * height lines of position and normal; a direction to each light.
   Writes for each light (once, with its own lights) width * height RGB floats, row 0 at the bottom. */
#include <GL/osmesa.h>
#include <GL/gl.h>
#include <GL/glext.h>
#include <stdio.h>
#include <stdlib.h>
#include MATERIAL_FILE

int main(void)
{
    int own, width, height, lights;
    if (scanf("%d %d %d %d", &own, &width, &height, &lights) != 4) return 1;
    int count = width * height;
    float *points = malloc(6 * count * sizeof(float)), *image = malloc(4 * count * sizeof(float));
    for (int i = 0; i < 6 * count; i++)
        if (scanf("%f", &points[i]) != 1) return 1;
    OSMesaContext context = OSMesaCreateContextExt(OSMESA_RGBA, 24, 0, 0, NULL);
    if (!context || !OSMesaMakeCurrent(context, image, GL_FLOAT, width, height)) return 2;
    PFNGLCLAMPCOLORPROC clamp = (PFNGLCLAMPCOLORPROC)OSMesaGetProcAddress("glClampColor");
    clamp(GL_CLAMP_VERTEX_COLOR_ARB, GL_FALSE);
    clamp(GL_CLAMP_FRAGMENT_COLOR_ARB, GL_FALSE);
    glEnable(GL_LIGHTING);
    glDisable(GL_DITHER);
    glLightModelfv(GL_LIGHT_MODEL_AMBIENT, (GLfloat[]){1, 1, 1, 1});
    glLightModeli(GL_LIGHT_MODEL_LOCAL_VIEWER, GL_FALSE);
    glMatrixMode(GL_PROJECTION);
    glOrtho(-1, 1, -1, 1, 0, 10);
    glMatrixMode(GL_MODELVIEW);
    glTranslatef(0, 0, -4); /* the eye is at (0, 0, 4) */
    MATERIAL_CALL();
#ifdef LIGHTS_CALL
    LIGHTS_CALL();
#endif
    for (int k = 0; k < (own ? 1 : lights); k++) {
        if (!own) {
            float to[4] = {0, 0, 0, 0}, white[4] = {1, 1, 1, 1}, black[4] = {0, 0, 0, 1};
            if (scanf("%f %f %f", &to[0], &to[1], &to[2]) != 3) return 1;
            glLightfv(GL_LIGHT0, GL_POSITION, to);
            glLightfv(GL_LIGHT0, GL_DIFFUSE, white);
            glLightfv(GL_LIGHT0, GL_SPECULAR, white);
            glLightfv(GL_LIGHT0, GL_AMBIENT, black);
            glEnable(GL_LIGHT0);
        }
        glClearColor(0, 0, 0, 0);
        glClear(GL_COLOR_BUFFER_BIT);
        glBegin(GL_POINTS);
        for (int i = 0; i < count; i++) {
            glNormal3fv(points + 6 * i + 3);
            glVertex3fv(points + 6 * i);
        }
        glEnd();
        glFinish();
        if (glGetError() != GL_NO_ERROR) return 3;
        for (int i = 0; i < count; i++) fwrite(image + 4 * i, sizeof(float), 3, stdout);
    }
    return 0;
}
